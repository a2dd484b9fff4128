"""Choice of a backend for a device, and of kernels for its tensors."""

from __future__ import annotations

import os
import re
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.errors import SgError, extra

if TYPE_CHECKING:
    import torch


def checked_device(device: object) -> torch.device:
    """Return a torch.device, from its name or a torch.device; the CPU for None.

    Raises SgError for a device that is missing or holds no values, and MissingPackageError without torch.
    """
    name = "cpu" if device is None else str(device)
    with extra("torch"):
        import torch
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError) as error:  # torch raises either for a device it was not built for
        reason = re.split(r"\.\s|\n", str(error))[0]  # the rest is about torch's own code
        raise SgError(f"there is no device {name!r} here: {reason}") from error
    return torch.device(name)


def backend_on(device: object) -> Backend:
    """Return the compiled kernels for None and "cpu", else a backend of tensors. Raises like checked_device()."""
    if device is None or str(device) == "cpu":
        return Kernels()
    found = checked_device(device)
    from sgmethod.backend.tensors import Tensors

    return Tensors(found, has_tiles(found))


def has_tiles(device: torch.device) -> bool:
    """Whether backend/tiles.py computes there: on CUDA with Triton, and on the CPU where Triton interprets."""
    interprets = os.environ.get("TRITON_INTERPRET") == "1"
    return device.type == ("cpu" if interprets else "cuda") and _has_triton()


@cache
def _has_triton() -> bool:
    return find_spec("triton") is not None
