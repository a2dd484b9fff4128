"""The worker: claims jobs, has them encoded, and publishes the results.

It also sends webhooks to the operator's addresses, and removes files that no job needs.
"""
