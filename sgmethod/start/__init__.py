"""Initial Gaussians: from a picture and their number.

Where the picture has structure, there are more of them, and they are smaller (paper, section III-B).
"""
