"""What tests and benchmarks start and look at: services, PostgreSQL, an S3 server, a browser, golden files.

A test asks for one of them, and it is gone after the test.
Nothing here imports a test or a benchmark.
"""
