"""The worker: claims jobs, has them encoded, and publishes the results.

It also removes files that no job needs.
"""
