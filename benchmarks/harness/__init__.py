"""What tests and benchmarks start and look at: services, PostgreSQL, an S3 server, a browser, golden files.

A fixture starts what a test asks for, and ends it after the test.
Nothing here imports a test or a command of benchmarks.
"""
