"""The .sg file, one module for each version of the format.

Bytes come in, and leave as the scene that a decoder draws; quantised Gaussians come in, and leave as bytes.
container.py knows signature, version and checksum, and which module reads which version; text.py converts files to
text and back. fields.py reads and writes the headers.
"""
