"""What people see, in figures: metrics that follow the eye, beside AVIF at the same bytes, and sheets of crops."""
