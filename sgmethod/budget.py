"""The budget of an encode: one number and its unit."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from typing import Literal, get_args

from sgmethod.arguments import AnyFloat, finite_number
from sgmethod.errors import BudgetError

BudgetKind = Literal["bpp", "bytes", "quality", "psnr", "gaussians"]
BUDGET_KINDS: tuple[BudgetKind, ...] = get_args(BudgetKind)

MAX_PSNR_DB = 60.0  # 8-bit rounding alone limits the PSNR to 58.9 dB

MAX_QUALITY = 100.0

MAX_GAUSSIANS = 1 << 24  # in a file

QualityName = Literal["preview", "web", "archive"]
QUALITIES: dict[str, float] = {"preview": 40.0, "web": 60.0, "archive": 80.0}

SIZE = re.compile(r"([+-]?[0-9]+\.?[0-9]*|[+-]?\.[0-9]+)\s*(?:(k|m|)b?|(ki|mi)b)", re.IGNORECASE | re.ASCII)
UNITS = {"": 1, "k": 1000, "m": 1000**2, "ki": 1024, "mi": 1024**2}


def quality_value(name: str) -> float:
    """Return the value of a name in QUALITIES. Raises BudgetError for another."""
    if name not in QUALITIES:
        raise BudgetError(f"quality must be a number or one of {', '.join(QUALITIES)}, got {name!r}")
    return QUALITIES[name]


def bytes_value(text: str) -> float:
    """Return a size in bytes: 20000, 20k, 20kB, 1.5MB, 20KiB or 1MiB. Raises BudgetError for another text."""
    if parts := SIZE.fullmatch(text):
        unit = (parts[2] or parts[3] or "").lower()
        with suppress(ArithmeticError):
            return float(Decimal(parts[1]) * UNITS[unit])  # in decimals, so that 1.001k is whole
    raise BudgetError(f"a size is a number of bytes, such as 20000, 20k or 1.5MB, not {text!r}")


@dataclass(frozen=True, init=False)
class Budget:
    """The target of an encode.

    kind: "bpp" (bits per pixel) and "bytes" are limits on the file size, never exceeded; "quality" is a SSIMULACRA 2 to
    reach (above 0 and up to 100, profile rd only), or "preview" for 40, "web" for 60 and "archive" for 80, in as few
    bytes as the profile manages; "psnr" the same in dB (whole picture, 8-bit RGB); "gaussians" is the number of
    Gaussians, for profile rd a maximum.
    value: a number; for bytes also a text, such as "20k" or "1.5MB" (thousands) or "20KiB" (1,024).
    max_bpp: for a quality, also a limit on the file size in bits per pixel.

    Raises BudgetError if value is not a positive finite number or, for bytes and gaussians, not whole.
    """

    kind: BudgetKind
    value: float
    max_bpp: float | None = None

    def __init__(self, kind: BudgetKind, value: AnyFloat | str, *, max_bpp: AnyFloat | None = None) -> None:
        if kind not in BUDGET_KINDS:
            raise BudgetError(f"unknown budget {kind!r}; use one of {', '.join(BUDGET_KINDS)}")
        named = {"quality": quality_value, "bytes": bytes_value}.get(kind)
        number = finite_number(named(value) if named is not None and isinstance(value, str) else value)
        if number is None or number <= 0:
            raise BudgetError(f"{kind} must be a positive number, got {value!r}")
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "value", number)
        limit = None if max_bpp is None else finite_number(max_bpp)
        if max_bpp is not None and (kind != "quality" or limit is None or limit <= 0):
            raise BudgetError(f"max_bpp is a positive number beside a quality, got {max_bpp!r} beside {kind}")
        object.__setattr__(self, "max_bpp", limit)
        self._check()

    def _check(self) -> None:
        value = self.value
        if self.kind in ("bytes", "gaussians") and value != int(value):
            raise BudgetError(f"{self.kind} must be a whole number, got {value}")
        if self.kind == "quality" and value > MAX_QUALITY:
            raise BudgetError(f"quality must be at most {MAX_QUALITY:g}, got {value}")
        if self.kind == "psnr" and value > MAX_PSNR_DB:
            raise BudgetError(f"psnr must be at most {MAX_PSNR_DB:g} dB, got {value}")

    def max_bytes(self, width: int, height: int) -> int | None:
        """Return the largest file size in bytes allowed, or None if this kind of budget does not limit the size."""
        if self.kind == "bytes":
            return int(min(self.value, 1e15))  # far beyond any file, so that later arithmetic in floats cannot overflow
        bpp = self.value if self.kind == "bpp" else self.max_bpp
        return None if bpp is None else int(min(bpp, 1e6) * width * height / 8)

    def max_gaussians(self, width: int, height: int) -> int:
        """Return the requested number of Gaussians. Raises BudgetError if no file of the picture can hold them."""
        if self.value > width * height:
            raise BudgetError(f"{int(self.value)} Gaussians exceed the image's {width * height} pixels")
        if self.value > MAX_GAUSSIANS:
            raise BudgetError(f"{int(self.value)} Gaussians exceed the {MAX_GAUSSIANS} that a file can hold")
        return int(self.value)


DEFAULT_BUDGET = Budget("quality", "web", max_bpp=0.5)


def default_budget(width: int, height: int, least: int, *, has_quality: bool) -> Budget:
    """Return a picture's default budget: DEFAULT_BUDGET, or its bytes where SSIMULACRA 2 cannot be aimed at.

    least: the smallest file, in bytes, which a very small picture may take.
    """
    allowed = DEFAULT_BUDGET.max_bytes(width, height) or 0
    return DEFAULT_BUDGET if has_quality and allowed >= least else Budget("bytes", max(allowed, least))
