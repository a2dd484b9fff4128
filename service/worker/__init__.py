"""The worker: one job at a time, each encoded in a process of its own.

A claimed job and its source image come in.
A bitstream or a reason for failure leaves, and files that no job needs are removed.
"""
