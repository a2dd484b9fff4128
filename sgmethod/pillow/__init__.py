"""Pillow's side: .sg files as one of its formats.

An .sg file comes in through Image.open, and leaves as a picture; a picture leaves through its save as an .sg file.
The package registers it when it is imported itself; numpy and torch wait for the first picture.
"""
