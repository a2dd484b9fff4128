"""Encoding: run a profile's pipeline, such as rd/picture.py, and measure the file."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

from sgmethod.arguments import AnyFloat, AnyInt
from sgmethod.budget import Budget, BudgetKind, QualityName
from sgmethod.encode_arguments import EncodeArguments, checked_time_limit, only_budget
from sgmethod.encoded import Encoded, measured
from sgmethod.errors import ImageError
from sgmethod.fitting.deadline import Clock
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.files import checked_path
from sgmethod.io.image import Input, read_input
from sgmethod.numerics import quiet
from sgmethod.profiles import DEFAULT_PROFILE, Profile, Tune, encoder_of, method_of
from sgmethod.trace import Progress


@quiet
def encode(
    image: Input,
    budget: Budget | None = None,
    profile: Profile = DEFAULT_PROFILE,
    *,
    bpp: AnyFloat | None = None,
    bytes: AnyInt | str | None = None,
    quality: AnyFloat | QualityName | None = None,
    psnr: AnyFloat | None = None,
    gaussians: AnyInt | None = None,
    tune: Tune | None = None,
    effort: AnyInt | None = None,
    time_limit_s: AnyFloat | None = None,
    on_progress: Progress | None = None,
    measure: bool = False,
) -> Encoded:
    """Encode a picture within a budget.

    >>> encoded = sgmethod.encode("photo.jpg", bpp=0.3)
    >>> encoded.stats.bpp <= 0.3
    True
    >>> encoded.save("photo.sg")
    >>> sgmethod.encode(np.zeros((48, 64), np.uint8), psnr=40).stats.width
    64

    image: the path or bytes of an image file, a Pillow image, or an sRGB array [H, W], [H, W, 1], [H, W, 3] or [H, W,
    4] in uint8, uint16 or floating point in [0, 1]. sgmethod/io/image.py has the rules for files. Input is rounded to 8
    bits, and the figures are relative to that. Profile rd keeps alpha; the others composite it over white, with a
    warning.
    bpp, bytes, quality, psnr, gaussians: at most one of these, or a Budget, which documents them; the default is
    quality 60, but at most 0.5 bpp.
    profile: "rd", or another of sgmethod.profiles.PROFILE_NAMES, which are for research.
    tune: "visual" (the default of profile rd) looks most like the picture; "fidelity" is the same without the noise
    that stands in for grain; "psnr" has the least squared error. Budgets in dB and other profiles support only "psnr".
    effort: 1 (fastest) to 9 (best file), by default 5 up to 2 megapixels, 3 up to 6, and 2 beyond; profile rd only.
    time_limit_s: limit for the whole encode, which uses it up unless it needs less. About 0.1 s per megapixel, divided
    by the cores, is needed in any case; a profile that can fit nothing in it raises BudgetError. Without a limit, the
    same call gives the same file on the same machine.
    on_progress: called with each point of the trace; if it raises, the encode is abandoned.
    measure: also measure SSIMULACRA 2, which takes a large part of the time of a small encode.

    Anything dropped from the input raises an ImageWarning. Raises ImageError for anything that is not a picture,
    BudgetError for a budget that no file can meet, OSError for a path that cannot be read, and MemoryError.
    """
    kinds: dict[BudgetKind, Any] = {"bpp": bpp, "bytes": bytes, "quality": quality, "psnr": psnr}
    only = only_budget(budget, kinds | {"gaussians": gaussians})
    asked = EncodeArguments.checked(only, profile, tune, effort)
    return encode_as(asked, image, checked_time_limit(time_limit_s), on_progress, measure)


@quiet
def encode_as(
    asked: EncodeArguments,
    image: Input,
    limit_s: float | None = None,
    on_progress: Progress | None = None,
    measure: bool = False,
) -> Encoded:
    """Encode with checked arguments, whose settings may be any."""
    clock = Clock()
    pixels = read_input(image, keep_alpha=method_of(asked.profile).keeps_alpha)
    source_bytes = _file_bytes(image)  # now, as the file may be deleted meanwhile
    height, width, channels = pixels.shape
    asked = asked.for_size(width, height, has_alpha=channels == 4)
    recorder = Recorder(clock, on_progress)
    data, steps = encoder_of(asked.profile)(pixels, asked, limit_s, recorder)
    stats = measured(pixels, data, steps, recorder, asked, measure)
    return Encoded(data, replace(stats, source_bytes=source_bytes), recorder.points)


def _file_bytes(image: Input) -> int | None:
    """Size of the image file; None for Pillow images and arrays."""
    if isinstance(image, str | os.PathLike):
        return checked_path(image, ImageError).stat().st_size or None  # 0 for a pipe
    return memoryview(image).nbytes if isinstance(image, bytes | bytearray | memoryview) else None
