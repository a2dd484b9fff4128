"""What tests and benchmarks both start and look at: services, nginx, PostgreSQL, pictures, golden files.

A fixture starts what a test asks for, and ends it after the test.
Nothing here imports a test or a command of benchmarks.
"""
