"""The .sg file, one module for each version of the format.

Bytes come in, and leave as the scene that a decoder draws; quantised Gaussians come in, and leave as bytes.
container.py knows what all versions share: magic, version, checksum, and which module reads which version.
"""
