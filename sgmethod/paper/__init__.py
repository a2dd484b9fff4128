"""Profiles paper and baseline: the paper's method, and what it is compared with.

A request comes in: a picture and what the file may spend.
The bytes of a version 1 file leave, after a structure-guided start, a fit and quantisation-aware tuning.
"""

from sgmethod.errors import extra

with extra("torch"):
    import torch  # noqa: F401
    from skimage import segmentation  # noqa: F401
