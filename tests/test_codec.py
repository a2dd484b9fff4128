"""encode(): budgets kept, figures true, odd pictures and bad budgets met, the same call giving the same file."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

import sgmethod
from sgmethod import Budget, BudgetError, Encoded, ImageError, Stats, TracePoint, decode, info
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.profiles import DEFAULT_EFFORT, DEFAULT_TUNE, PROFILE_NAMES, TUNES, tuning
from tests.support.pictures import ODD, noise, photo
from tests.support.profiles import encode_with, shorten, shortened

FloatArray = NDArray[np.float32]
# Where a slow test of one profile tells as much as one of each.
SLOWLY = [name if name == "rd" else pytest.param(name, marks=pytest.mark.thorough) for name in PROFILE_NAMES]

PHOTO = photo() / np.float32(255)
SMALL = PHOTO[20:52, 40:88]


def encode(image: Any, budget: Budget | None = None, profile: str = "rd", **named: Any) -> Encoded:
    """In a fraction of a second."""
    with pytest.MonkeyPatch.context() as patched:
        shorten(patched, 400)
        return sgmethod.encode(image, budget, profile, **named)


def source(pixels: FloatArray) -> NDArray[np.uint8]:
    return np.round(pixels * 255).astype(np.uint8)


def flat(pixels: FloatArray) -> float:
    """PSNR in dB of the mean colour alone."""
    return -10 * math.log10(max(float(pixels.var((0, 1)).mean()), 1e-12))


def assert_true_figures(encoded: Encoded, pixels: FloatArray) -> None:
    """What the result says of itself is what its bytes come to."""
    stats, decoded = encoded.stats, decode(encoded.data)
    height, width = pixels.shape[:2]
    assert decoded.shape == pixels.shape
    assert stats.bytes == len(encoded.data) == info(encoded.data).bytes
    assert stats.bpp == 8 * len(encoded.data) / (width * height)
    assert (stats.width, stats.height) == (width, height)
    assert stats.psnr == psnr(decoded, source(pixels))
    assert stats.ssimulacra2 in (None, ssimulacra2(decoded, source(pixels)))
    assert stats.gaussians == info(encoded.data).gaussians
    assert stats.profile == info(encoded.data).profile


@pytest.mark.parametrize("profile", SLOWLY)
@pytest.mark.parametrize(
    ("picture", "budget"),
    [
        ("kodim05-crop", Budget("bpp", 1.0)),
        ("kodim04-crop", Budget("bpp", 1.0)),
        ("kodim23-crop", Budget("bytes", 300)),
        ("kodim23-crop", Budget("bytes", 901)),
    ],
)
def test_a_rate_or_size_is_kept_and_used(picture: str, budget: Budget, profile: str) -> None:
    pixels = photo(picture) / np.float32(255)
    encoded = encode(pixels, budget, profile)
    assert_true_figures(encoded, pixels)
    most = budget.max_bytes(*pixels.shape[1::-1]) or 0
    assert 0.95 * most <= len(encoded.data) <= most


@pytest.mark.parametrize("profile", SLOWLY)
def test_more_bytes_give_a_better_picture(profile: str) -> None:
    quality = [encode(PHOTO, Budget("bytes", size), profile).stats.psnr for size in (300, 700, 1600)]
    assert quality == sorted(quality)


@pytest.mark.parametrize("profile", SLOWLY)
def test_a_quality_is_reached_with_a_file_to_match(profile: str) -> None:
    encoded = [encode(PHOTO, Budget("psnr", db), profile) for db in (20, 26)]
    for db, each in zip((20, 26), encoded, strict=True):
        assert_true_figures(each, PHOTO)
        assert each.stats.psnr >= db
    assert len(encoded[0].data) < 0.5 * len(encoded[1].data)  # 0.12 and 0.22 seen


@pytest.mark.parametrize("kind", ["bpp", "bytes", "psnr", "quality", "gaussians"])
@pytest.mark.parametrize("value", [0, -1, -0.0, math.nan, math.inf, -math.inf])
def test_a_budget_is_a_positive_number(kind: str, value: float) -> None:
    with pytest.raises(BudgetError, match="positive"):
        Budget(kind, value)  # type: ignore[arg-type]
    with pytest.raises(BudgetError, match="max_bpp is a positive number"):
        Budget("quality", 50, max_bpp=value)


def test_only_a_quality_has_a_limit_in_bits_per_pixel() -> None:
    assert Budget("quality", 50, max_bpp=1).max_bytes(64, 48) == Budget("bpp", 1).max_bytes(64, 48) == 384
    assert Budget("quality", 50).max_bytes(64, 48) is None
    with pytest.raises(BudgetError, match="beside a quality, got 1 beside bpp"):
        Budget("bpp", 1, max_bpp=1)


def test_budgets_that_no_file_can_meet() -> None:
    for kind, value in (("bytes", 1.5), ("gaussians", 2.5), ("psnr", 61), ("quality", 101), ("dollars", 1)):
        with pytest.raises(BudgetError):
            Budget(kind, value)  # type: ignore[arg-type]
    for budget in (Budget("bytes", 1), Budget("bytes", 11), Budget("bpp", 1e-9)):
        for profile in PROFILE_NAMES:
            with pytest.raises(BudgetError, match="takes at least"):
                encode(SMALL, budget, profile)
    with pytest.raises(BudgetError, match="exceed the image's 35 pixels"):
        encode(noise(5, 7), Budget("gaussians", 36))


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_the_smallest_size_named_is_possible(profile: str) -> None:
    with pytest.raises(BudgetError) as refused:
        encode(SMALL, Budget("bytes", 5), profile)
    named = re.search(r"at least (\d+) bytes", str(refused.value))
    assert named
    least = int(named[1])
    encoded = encode(SMALL, Budget("bytes", least), profile)
    assert_true_figures(encoded, SMALL)
    assert len(encoded.data) <= least
    with pytest.raises(BudgetError):
        encode(SMALL, Budget("bytes", least - 1), profile)


def test_what_an_encode_is_tuned_for() -> None:
    assert [tuning(None, profile, Budget("bpp", 1)) for profile in PROFILE_NAMES] == [DEFAULT_TUNE, "psnr"]
    assert tuning(None, "rd", Budget("psnr", 30)) == "psnr"
    for tune in TUNES:
        assert encode(SMALL, Budget("bpp", 4), tune=tune).stats.tune == tune


@pytest.mark.parametrize("profile", SLOWLY)
@pytest.mark.parametrize("name", ODD)
def test_odd_pictures(name: str, profile: str) -> None:
    pixels = ODD[name].copy()
    pixels.setflags(write=False)  # which the picture is left as
    encoded = encode(pixels, Budget("bytes", 600), profile)
    assert_true_figures(encoded, pixels)
    assert len(encoded.data) <= 600
    assert encoded.stats.psnr > min(flat(pixels), 30) - 1  # worst seen: at it, on the checkerboard
    if name == "black":
        assert not decode(encoded.data).any()
        assert json.loads(json.dumps(encoded.stats.to_dict(), allow_nan=False))["psnr"] is None


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_few_steps_still_give_a_picture(profile: str) -> None:
    few = shortened(60)[profile]
    for size in (400, 1600):
        stats = encode_with(few, PHOTO, Budget("bytes", size)).stats
        assert (stats.profile, stats.effort) == (profile, DEFAULT_EFFORT)
        assert stats.psnr > flat(PHOTO) + 2  # 4.9 seen


@pytest.mark.parametrize(
    ("changes", "warnings"),
    [
        ({"source_bytes": 1000}, []),
        ({"source_bytes": 999}, ["the file is larger than its source: 1,000 bytes, source 999"]),
        ({"psnr_missed_db": 0.004}, []),
        ({"psnr_missed_db": 18.77}, ["the requested PSNR is missed by 18.77 dB: the file has 31.23 dB"]),
        ({"quality_missed": 0.9}, []),
        ({"quality_missed": 18.74}, ["the requested quality is missed by 18.7: the file has 51.3"]),
        ({"gaussians": 0}, ["the file contains only a background and no Gaussians: try a larger budget"]),
        ({"gaussians": 0, "psnr_missed_db": 0.0}, []),  # which is what was asked for
        ({"gaussians": 0, "psnr": math.inf}, []),  # a picture of one colour
    ],
)
def test_warnings(changes: dict[str, Any], warnings: list[str]) -> None:
    stats = replace(Stats(1000, 0.5, 31.234, 51.26, 9, 60, 1.0, 128, 96, "rd", "psnr", 5), **changes)
    assert stats.warnings == warnings
    figures = stats.to_dict()
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert figures["warnings"] == warnings


def test_the_figures_know_the_source_and_the_miss(tmp_path: Path) -> None:
    path, levels = tmp_path / "photo.png", source(PHOTO)
    Image.fromarray(levels).save(path)
    data = path.read_bytes()
    for image, size in ((path, len(data)), (str(path), len(data)), (bytearray(data), len(data)), (levels, None)):
        assert encode(image, bytes=400).stats.source_bytes == size
    removed = encode(path, bytes=400, on_progress=lambda _: path.unlink(missing_ok=True))
    assert (removed.stats.source_bytes, path.exists()) == (len(data), False)
    missed = encode(levels, psnr=60, time_limit_s=0.05).stats
    assert missed.psnr_missed_db == pytest.approx(60 - missed.psnr)
    assert missed.warnings[0].startswith("the requested PSNR is missed by")
    met = encode(levels, psnr=20).stats
    assert (met.psnr_missed_db, met.warnings) == (0.0, [])
    assert [text.partition(":")[0] for text in encode(levels, bytes=13).stats.warnings] == [
        "the file contains only a background and no Gaussians"
    ]


def test_ssimulacra2_is_that_of_the_file_if_it_is_asked_for() -> None:
    encoded = encode(PHOTO, Budget("bytes", 600), measure=True)
    assert_true_figures(encoded, PHOTO)
    assert encoded.stats.ssimulacra2 is not None
    assert encode(PHOTO, bytes=200, effort=1).stats.ssimulacra2 is None


@pytest.mark.parametrize(
    "wrong",
    [
        *(np.zeros(shape) for shape in (5, (4, 5, 2), (2, 4, 5, 3), (0, 5, 3), (4, 0, 3), (1, 65_536, 3))),
        np.broadcast_to(np.float32(0), (10_001, 10_000, 3)),  # which decode() would refuse
        *(np.full((4, 5, 3), value) for value in (-1e-3, 1.001, np.nan, np.inf)),
        np.full((4, 5, 3), 255, np.uint32),
        *(np.full((4, 5, 3), value) for value in (0.5 + 0.5j, "0.5", None)),
    ],
    ids=lambda a: f"{a.dtype} {a.shape} {a.flat[0] if a.size else ''}",
)
def test_arrays_that_are_no_image(wrong: NDArray[np.float32]) -> None:
    with pytest.raises(ImageError):
        encode(wrong, Budget("bytes", 400))


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_kernels_get_no_tensors(profile: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors are handed over in Python code, where an interrupt that arrives is lost."""
    seen = []
    by_torch = torch.Tensor.__dlpack__

    def watched(*arguments: object, **named: object) -> object:
        seen.append(arguments)
        return by_torch(*arguments, **named)

    monkeypatch.setattr(torch.Tensor, "__dlpack__", watched)
    encode(SMALL, Budget("bpp", 4), profile=profile)
    assert not seen


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_the_trace_runs_through_all_phases(profile: str) -> None:
    seen: list[TracePoint] = []
    encoded = encode(SMALL, Budget("bytes", 400), profile, on_progress=seen.append)
    assert encoded.trace == seen
    phases = [p.phase for p in seen]
    assert list(dict.fromkeys(phases)) == ["joint", "search", "done"] if profile == "rd" else ["fit", "tune", "done"]
    assert phases.count("done") == 1
    for a, b in pairwise(seen):
        assert b.seconds >= a.seconds
        assert b.step > a.step or b.phase != a.phase
    last = seen[-1]
    assert last.bytes == len(encoded.data)
    assert last.gaussians == encoded.stats.gaussians
    assert last.psnr == pytest.approx(encoded.stats.psnr, abs=1e-3)
    assert last.step == last.steps == encoded.stats.steps
    assert encoded.stats.seconds >= last.seconds - 1e-4  # the trace rounds to that


@pytest.mark.parametrize("profile", SLOWLY)
def test_the_same_call_gives_the_same_file(profile: str) -> None:
    one, same = (encode(SMALL, Budget("bytes", 400), profile).data for _ in range(2))
    assert one == same
