"""Pictures and files, in and out.

Image files, Pillow images and arrays become sRGB levels: image.py has the rules and the list of steps, opening.py opens
and checks, decoding.py reads the samples, colour.py knows colour spaces, formats.py, chunks.py and items.py know file
formats. Decoded pixels become files of five formats (pictures.py, png.py), perhaps the largest within a number of bytes
(within.py). files.py writes every file completely or not at all.
"""
