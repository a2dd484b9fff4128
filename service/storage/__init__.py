"""Source images and bitstreams under keys, in a folder or in a bucket.

Bytes come in under a key that is made of a job's id.
The same bytes leave, or nothing: a file is whole or absent.
"""
