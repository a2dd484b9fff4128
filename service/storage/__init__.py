"""Source images and bitstreams under keys, in a folder or in a bucket.

A key is made of a job's id. A file is whole or absent.
"""
