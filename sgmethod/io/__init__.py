"""Pictures and files, in and out.

Image files of ten formats come in, pictures of Pillow's and arrays too, and leave as levels of sRGB.
Decoded pixels leave in five formats, and every file that is written is whole or absent.
"""

from sgmethod.io.files import write_atomically
from sgmethod.io.image import read_image, read_image_8_bit
from sgmethod.io.png import encode_png

__all__ = ["encode_png", "read_image", "read_image_8_bit", "write_atomically"]
