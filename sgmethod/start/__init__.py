"""Initial Gaussians: from a picture and their number.

Where the picture has structure, there are more of them (paper, section III-B); in profile rd, they are smaller there,
too.
"""
