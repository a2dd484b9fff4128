"""Previews for web pages: a picture as a short text, to show until the picture has loaded.

A picture of any size is reduced to as many pixels as the bytes can show, and encoded. The result has the text, the
picture's own size, its average colour, and HTML that uses them.
"""
