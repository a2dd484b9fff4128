"""Pictures and files, in and out.

Image files of five formats come in, and leave as arrays.
Decoded pixels leave as PNG, and every file that is written is whole or absent.
"""

from sgmethod.io.files import write_atomically
from sgmethod.io.image import read_image, read_image_8_bit
from sgmethod.io.png import encode_png

__all__ = ["encode_png", "read_image", "read_image_8_bit", "write_atomically"]
