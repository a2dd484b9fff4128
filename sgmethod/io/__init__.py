"""Pictures and files, in and out.

Image files of five formats come in, and leave as arrays.
Decoded pixels leave as PNG, and every file that is written is whole or absent.
"""
