"""The worker runs one job at a time, each in the sandbox.

A claim on a job and the job's source image come in.
A bitstream leaves, or the reason of a failure, and the operator's addresses are told; files that no job needs go.
"""
