"""Devices that PyTorch may compute on, and whether Triton's kernels run there."""

from __future__ import annotations

import os
import re
from functools import cache
from importlib.util import find_spec

import torch

from sgmethod.errors import SgError


def checked_device(device: object) -> torch.device:
    """Return a torch.device, from its name or a torch.device; the CPU for None.

    Raises SgError for a device that is missing or holds no values.
    """
    name = "cpu" if device is None else str(device)
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError) as error:  # torch raises either for a device it was not built for
        reason = re.split(r"\.\s|\n", str(error))[0]  # the rest is about torch's own code
        raise SgError(f"there is no device {name!r} here: {reason}") from error
    return torch.device(name)


def has_tiles(device: torch.device) -> bool:
    """Whether tiles.py computes there: on CUDA with Triton, and on the CPU where Triton interprets."""
    interprets = os.environ.get("TRITON_INTERPRET") == "1"
    return device.type == ("cpu" if interprets else "cuda") and _has_triton()


@cache
def _has_triton() -> bool:
    return find_spec("triton") is not None
