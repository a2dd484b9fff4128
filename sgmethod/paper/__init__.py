"""Profile paper: the method of the paper.

A picture is encoded to a version 1 file by a structure-guided start, a fit and quantisation-aware tuning.
"""

from sgmethod.errors import extra

with extra("torch"):
    import torch  # noqa: F401
    from skimage import segmentation  # noqa: F401
