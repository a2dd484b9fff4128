"""Previews for pages: a picture as a short text, with what a page must know before the picture has loaded.

A picture of any size comes in, is reduced to what so few bytes can show, and encoded. A text leaves, with the picture's
own size, its average colour, and HTML that holds both.
"""
