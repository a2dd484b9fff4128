"""Metrics that are designed to agree with people, compared with AVIF at the same size; and sheets of crops."""
