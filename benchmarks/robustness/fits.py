"""Fits from bad starts, at rates that are too high, with too few Gaussians and too many, under impossible budgets and
time limits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.pictures import MIRRORS, Pixels, mirrored, photograph
from benchmarks.robustness.case import Case, Cases, Found
from benchmarks.robustness.drawings import PICTURES as HARD, text
from sgmethod import Budget, BudgetError, decode, encode
from sgmethod.codec import encode_as
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.metrics import psnr
from sgmethod.paper import encode as paper
from sgmethod.paper.settings import PaperSettings
from sgmethod.profiles import DEFAULT_EFFORT, TUNES, Profile, Settings, Tune, method_of
from sgmethod.rd import encode as rd
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings
from sgmethod.settings.shared import OptimiserSettings

BPP = 1.0
LIMITS_S = (1e-9, 0.01, 0.1)
RULE = "dB that the file is worse than the first error of its trace, or than one colour"
SIZE_RULE = "bytes above the budget, or an error that is no BudgetError"
SPREAD_LIMIT_DB, GENERATIONS_LIMIT_DB = 0.5, 1.0
Patch = Callable[[], AbstractContextManager[None]]
PLACED_BY = {"rd": (rd, "place"), "paper": (paper, "place_by_structure")}  # each calls it by that name
KINDS: dict[str, tuple[Profile, Tune]] = {
    "profile rd": ("rd", "psnr"),
    "profile rd for the eye": ("rd", "visual"),
    "profile paper": ("paper", "psnr"),
}


def step(side: int) -> Pixels:
    """Black beside white: one edge, and nothing else."""
    pixels = np.zeros((side, side, 3), np.uint8)
    pixels[:, side // 2 :] = 255
    return pixels


PICTURES: dict[str, Callable[[int], Pixels]] = {"photograph": photograph, "text": text, "step": step}


def cases(side: int, generations: int) -> Cases:
    """Bad starts of profile rd on every picture, the rest on the photograph. side: of pictures, in pixels."""
    budget, pixels = Budget("bpp", BPP), photograph(side)
    for kind, (profile, tune) in KINDS.items():
        for name in PICTURES if profile == "rd" else ("photograph",):
            picture = PICTURES[name](side)
            for start, patched in starts(profile).items():
                measure = partial(worse, picture, budget, profile, tune, patched)
                yield Case(f"{name}, {kind}, {start}", RULE, 0.0, measure)
            measure = partial(worse, picture, budget, profile, tune, settings=fast(method_of(profile).settings))
            yield Case(f"{name}, {kind}, rates ten times too high", RULE, 0.0, measure)
        for limit_s in LIMITS_S:
            measure = partial(worse, pixels, budget, profile, tune, limit_s=limit_s)
            yield Case(f"photograph, {kind}, a time limit of {limit_s:g} s", RULE, 0.0, measure)
    for n in (1, 2, pixels.shape[0] * pixels.shape[1]):
        yield Case(f"{n:,} Gaussians", RULE, 0.0, partial(worse, pixels, Budget("gaussians", n), "rd", "psnr"))
    for count in (1, 11, 12, 13, 30, 100, pixels.size, 10 * pixels.size):
        yield Case(f"{count:,} bytes", SIZE_RULE, 0, partial(beyond, pixels, count))
    rule = "dB between the best and the worst"
    yield Case(f"{MIRRORS} mirror images", rule, SPREAD_LIMIT_DB, partial(spread, pixels))
    rule = "dB lost from the first to the last, each encoded from the one before"
    yield Case(f"{generations} generations", rule, GENERATIONS_LIMIT_DB, partial(lost, pixels, generations))


def starts(profile: str) -> dict[str, Patch]:
    """Ways in which the first Gaussians may be wrong."""

    module, name = PLACED_BY[profile]
    place = getattr(module, name)

    def spoiled(spoil: Callable[[Gaussians], None]) -> Patch:
        def placed(*arguments: Any, **named: Any) -> Gaussians:
            gaussians: Gaussians = place(*arguments, **named).copy()
            spoil(gaussians)
            return gaussians

        @contextmanager
        def patched() -> Iterator[None]:
            with patch.object(module, name, side_effect=placed) as called:
                yield
            assert called.called  # or it would be the start as it is

        return patched

    def equal(g: Gaussians) -> None:
        for values in g.arrays:
            values[:] = values[0]

    def singular(g: Gaussians) -> None:
        g.factors[:, 0::2] = 0

    def some(value: float, name: str) -> Callable[[Gaussians], None]:
        def spoil(g: Gaussians) -> None:
            getattr(g, name)[::2, 0] = value

        return spoil

    found: dict[str, Patch] = {"as it is": nullcontext, "all Gaussians equal at the start": spoiled(equal)}
    found["singular shapes at the start"] = spoiled(singular)
    for value, word in ((math.nan, "not a number"), (math.inf, "infinite")):
        for array in ("means", "factors"):
            found[f"every second {array[:-1]} {word} at the start"] = spoiled(some(value, array))
    return found


def fast(settings: Settings) -> Settings:
    """Settings with rates that are ten times too high."""

    def faster(s: OptimiserSettings) -> OptimiserSettings:
        return replace(s, mean_rate=10 * s.mean_rate, factor_rate=10 * s.factor_rate, color_rate=10 * s.color_rate)

    if isinstance(settings, PaperSettings):
        return replace(settings, optimiser=faster(settings.optimiser))
    assert isinstance(settings, RdSettings)
    return replace(settings, optimiser=faster(settings.optimiser))


def worse(
    pixels: Pixels,
    budget: Budget,
    profile: Profile,
    tune: Tune,
    patched: Patch = nullcontext,
    settings: Settings | None = None,
    limit_s: float | None = None,
) -> Found:
    """Measure by how much the file is worse than the start of its fit, or than a single colour."""
    asked = EncodeArguments.checked(budget, profile, tune, DEFAULT_EFFORT)
    with patched():
        encoded = encode_as(replace(asked, settings=settings or asked.settings), pixels, limit_s)
    mean = np.broadcast_to(pixels.mean((0, 1)).round().astype(np.uint8), pixels.shape)
    start_db = max(psnr(np.ascontiguousarray(mean), pixels), encoded.trace[0].psnr)
    return max(start_db - encoded.stats.psnr, 0.0), f"{encoded.stats.psnr:.2f} dB, from {encoded.trace[0].psnr:.2f} dB"


def beyond(pixels: Pixels, count: int) -> Found:
    """The budget is kept, or refused by name."""
    try:
        encoded = encode(pixels, Budget("bytes", count), tune="psnr")
    except BudgetError as error:
        return 0.0, f"refused: {error}"
    return float(max(encoded.stats.bytes - count, 0)), f"{encoded.stats.bytes:,} bytes, {encoded.stats.psnr:.2f} dB"


def spread(pixels: Pixels) -> Found:
    """Measure the spread of PSNR over the mirror images of a picture."""
    images = (mirrored(pixels, number) for number in range(MIRRORS))
    found = [encode(image, Budget("bpp", BPP), tune="psnr").stats.psnr for image in images]
    return max(found) - min(found), f"{min(found):.2f} to {max(found):.2f} dB"


def lost(pixels: Pixels, generations: int) -> Found:
    """Measure how much PSNR is lost when each encode gets the picture decoded before."""
    shown, found = pixels, []
    for _ in range(generations):
        shown = decode(encode(shown, Budget("bpp", BPP), tune="psnr").data)
        found.append(psnr(shown, pixels))
    return found[0] - found[-1], " ".join(f"{db:.2f}" for db in found)


STRICT_RULE = (
    "encodes that np.errstate(all='raise') or a filter of errors ends, of the bits per pixel and tunings tried"
)
STRICT_BPP = (0.3, 1.0, 3.0)


def strict_cases() -> Cases:
    """Hard pictures in a program that turns warnings into errors, and has NumPy raise on underflow."""
    for name in HARD:
        yield Case(name, STRICT_RULE, 0, partial(failures, HARD[name]))


def failures(make: Callable[[], Pixels]) -> Found:
    """Count the encodes of a picture that fail, and give the first error."""
    pixels, errors = make(), []
    with np.errstate(all="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        for bpp in STRICT_BPP:
            for tune in TUNES:
                try:
                    decode(encode(pixels, Budget("bpp", bpp), tune=tune).data)
                except BudgetError:  # a picture of a few pixels has less than the smallest file
                    pass
                except (ArithmeticError, Warning) as error:
                    errors.append(f"{type(error).__name__}: {error}")
    return len(errors), errors[0] if errors else ""
