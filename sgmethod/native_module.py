"""The compiled kernels, or a clear word on how to build them."""

from __future__ import annotations

from sgmethod.errors import NativeModuleError

try:
    from sgmethod import _native as native
except ImportError as error:  # pragma: no cover - an installation without its compiled part
    raise NativeModuleError(
        f"the compiled part of sgmethod cannot be loaded ({error}); build it with: pip install --force-reinstall ."
    ) from error

__all__ = ["native"]
