"""Where the first Gaussians are placed.

A picture and a number of Gaussians come in.
Gaussians leave, more of them and smaller where the picture has structure (paper, section III-B).
"""
