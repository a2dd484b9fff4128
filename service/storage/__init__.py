"""Source images and bitstreams under keys, in a folder or in a bucket.

Bytes come in under a key of ours.
The same bytes leave, or nothing at all: a file is whole or absent.
"""
