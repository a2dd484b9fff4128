"""Pictures and files, in and out.

Image files, Pillow images and arrays become sRGB levels: image.py has the rules and the list of steps, opening.py opens
and checks, decoding.py reads the samples, colour.py knows colour spaces. kinds/ has a module for each file format, and
formats.py lists them; chunks.py and items.py parse what several have. Decoded pixels become files (pictures.py), the
largest within a number of bytes if wanted (within.py). files.py writes every file completely or not at all.
"""
