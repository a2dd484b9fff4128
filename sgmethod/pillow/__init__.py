"""The Pillow plugin for .sg files.

Image.open reads an .sg file as a picture; save writes a picture as an .sg file. Importing sgmethod registers the
plugin; NumPy and the encoder are imported with the first picture.
"""
