"""Pictures and files, in and out.

Image files, Pillow images and arrays are converted to sRGB levels. Decoded pixels are written in five file formats;
every file is written completely or not at all.
"""
