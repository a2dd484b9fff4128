"""The .sg file.

Bytes come in, and leave as the scene that a decoder draws; quantised Gaussians come in, and leave as bytes.
container.py knows signature, version and checksum, v2.py all between them; text.py converts files to text and back.
fields.py reads and writes the headers.
"""
