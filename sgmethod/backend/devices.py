"""Which devices there are, and which backend computes on each."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.errors import SgError, extra

if TYPE_CHECKING:
    import torch


def own_device(device: object) -> torch.device:
    """A device of torch, from its name or a torch.device; the CPU for None. Raises SgError for one that is not there or
    holds no values, and MissingPackageError without torch."""
    name = "cpu" if device is None else str(device)
    with extra("torch"):
        import torch
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError) as error:  # of torch, for devices that it is not made for
        reason = re.split(r"\.\s|\n", str(error))[0]  # sentences about torch's own code follow
        raise SgError(f"there is no device {name!r} here: {reason}") from error
    return torch.device(name)


def backend_on(device: object) -> Backend:
    """The compiled kernels for None and "cpu"; for any other device, operations on tensors. Raises SgError as
    own_device() does."""
    if device is None or str(device) == "cpu":
        return Kernels()
    found = own_device(device)
    from sgmethod.backend.tensors import Tensors

    return Tensors(found)
