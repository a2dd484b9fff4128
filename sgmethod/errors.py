"""The errors a caller can expect.

SgError                 anything this package refuses, with one clear sentence
├── ImageError          an input that is not an image we can read, or beyond the limits
├── BitstreamError      bytes that are not a whole, intact .sg file
├── ViewError           a scale, region or prefix that makes no picture
├── GaussiansError      arrays that make no Gaussians, or Gaussians that no file can hold
├── BudgetError         a budget that is not a positive number, or too small for any file
├── ServerError         a service that cannot be reached, refuses, or fails to encode
└── NativeModuleError   the compiled kernels are missing; the message names the command that builds them

ImageWarning            what of an image is left out, where the rest of it is used
"""


class SgError(Exception):
    """Base of every error this package raises on purpose."""


class ImageError(SgError):
    """The input image cannot be read, or exceeds the stated limits."""


class BitstreamError(SgError):
    """The bytes are not a valid bitstream."""


class ViewError(SgError):
    """The scale, region or prefix makes no picture."""


class GaussiansError(SgError):
    """The arrays make no Gaussians, or no file can hold them."""


class BudgetError(SgError):
    """The budget is not a positive finite number, or no file fits in it."""


class ServerError(SgError):
    """The service cannot be reached, refuses what is asked of it, or failed to encode."""


class NativeModuleError(SgError):
    """The compiled kernels are not installed."""


class ImageWarning(UserWarning):
    """Something of the image is left out: further pictures, transparency, a damaged profile."""
