"""The .sg file, one module for each version of the format.

Bytes come in, and leave as the scene that a decoder draws; quantised Gaussians come in, and leave as bytes.
container.py knows what all versions share: magic, version, checksum, and which module reads which version. fields.py
reads and writes the headers, payload.py has what versions 3 and 4 share.
"""
