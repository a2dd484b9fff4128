"""Which backend computes on which device."""

from __future__ import annotations

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Backend
from sgmethod.errors import SgError, extra


def backend_on(device: object) -> Backend:
    """The compiled kernels for None and "cpu"; for any other device of torch, as its name or a torch.device, operations
    on tensors. Raises SgError for a device that is not there, or where torch is not installed."""
    if device is None or str(device) == "cpu":
        return Kernels()
    with extra("torch"):
        from sgmethod.backend.tensors import Tensors
    try:
        return Tensors(str(device))
    except (RuntimeError, AssertionError) as error:  # of torch, for devices that it is not made for
        raise SgError(f"there is no device {str(device)!r} here: {str(error).splitlines()[0]}") from error
