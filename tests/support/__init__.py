"""What tests share, and benchmarks start too: services, nginx, PostgreSQL, pictures, golden files.

A fixture starts what a test asks for, and ends it after the test.
Nothing here imports a test or a benchmark.
"""
