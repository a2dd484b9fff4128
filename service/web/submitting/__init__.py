"""What comes before a job.

The body of POST /encode comes in, as a form or as the image alone.
A request that can succeed leaves, with the image as a file and what its header says, or a refusal that names the cause.
"""
