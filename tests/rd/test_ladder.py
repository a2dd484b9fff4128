"""Stiff pictures: every budget finds the same files, so that more is never worse."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod import Budget, Encoded, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.budget import BudgetKind
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.request import Request
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.profiles import RD
from sgmethod.rd.finish import Finish, Found
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.runs import place
from sgmethod.trace import shown_to_nobody
from tests.harness.data import PHOTOGRAPHS

Pixels = NDArray[np.uint8]


def lines() -> Pixels:
    """One pixel wide, slanted, dark on white."""
    y, x = np.mgrid[0:48, 0:64]
    levels = np.where((3 * x + y) % 24 < 3, 30, 255).astype(np.uint8)
    return np.repeat(levels[..., None], 3, axis=2)


def squares() -> Pixels:
    """Of two pixels each: half of their size is squares of one, and a quarter is flat."""
    y, x = np.mgrid[0:48, 0:48]
    return np.repeat((255 * ((x // 2 + y // 2) % 2)).astype(np.uint8)[..., None], 3, axis=2)


def board() -> Pixels:
    """Squares of one pixel: nothing of them is left at half the size."""
    y, x = np.mgrid[0:40, 0:40]
    return np.repeat((255 * ((x + y) % 2)).astype(np.uint8)[..., None], 3, axis=2)


def noise() -> Pixels:
    return np.random.default_rng(3).integers(0, 256, (24, 32, 3), np.uint8)


STIFF = {"lines": lines, "squares": squares, "noise": noise}


@cache
def encoded(name: str, kind: BudgetKind, value: float, effort: int = 5) -> Encoded:
    return encode(STIFF[name](), Budget(kind, value), tune="psnr", effort=effort)


def error(name: str, file: Encoded) -> float:
    """PSNR of what the file decodes to, in dB."""
    return psnr(decode(file.data), STIFF[name]())


@pytest.mark.parametrize("name", STIFF)
def test_more_quality_is_never_worse_nor_smaller(name: str) -> None:
    files = [encoded(name, "quality", quality) for quality in (10, 30, 45, 60, 75, 100)]
    for less, more in pairwise(files):
        assert len(less.data) <= len(more.data)
        assert error(name, less) <= error(name, more)


@pytest.mark.parametrize("name", STIFF)
def test_a_quality_takes_no_fit_that_counts_for_nothing(name: str) -> None:
    """What its trace shows at the file's size is in the file. A time limit has such a fit to fall back on."""
    file = encoded(name, "quality", 45)
    assert max(point.psnr for point in file.trace if 0 < point.bytes <= len(file.data)) <= file.stats.psnr + 1e-4
    limited = encode(STIFF[name](), quality=45, tune="psnr", time_limit_s=100)
    assert limited.data == file.data
    assert file.stats.steps < limited.stats.steps


def test_a_quality_shows_each_rung() -> None:
    shown: list[bytes] = []
    file = encode(lines(), quality=60, tune="psnr", on_preview=shown.append)
    assert file.data in shown
    sizes = [len(data) for data in shown]
    assert sorted(sizes) == sizes


def test_a_quality_that_is_stopped_on_the_ladder_climbs_no_further() -> None:
    """What time is left is for a fit of its own, which comes to more than the first rungs or gives way to them."""
    shown: list[bytes] = []
    file = encode(noise(), quality=90, tune="psnr", on_preview=shown.append, stop=lambda: len(shown) > 2)
    assert len(shown) == 3
    assert file.stats.psnr >= max(psnr(decode(data), noise()) for data in shown)


@pytest.mark.parametrize("tune", ["psnr", "visual"])
def test_a_quality_of_nothing_is_the_background(tune: str) -> None:
    """With the grain that stands for noise, as where a time limit has a fit to fall back on."""
    file = encode(noise(), quality=1, tune=tune)
    assert file.stats.gaussians == 0
    assert file.data == encode(noise(), quality=1, tune=tune, time_limit_s=100).data
    assert bool(np.ptp(decode(file.data), axis=(0, 1)).any()) == (tune == "visual")


def test_a_checkerboard_of_single_pixels_gains_from_each_byte() -> None:
    found = [encode(board(), Budget("bytes", size), tune="psnr").stats.psnr for size in (300, 600, 1200, 2400)]
    for fewer, more in pairwise(found):
        assert more > fewer + 3
    assert found[-1] > 40


@pytest.mark.parametrize("name", STIFF)
def test_a_size_is_used_as_well_as_by_any_quality(name: str) -> None:
    for quality in (30, 60, 75):
        other = encoded(name, "quality", quality)
        file = encoded(name, "bytes", len(other.data))
        assert len(file.data) <= len(other.data)
        assert error(name, file) >= error(name, other)


@pytest.mark.parametrize("name", STIFF)
def test_a_psnr_takes_no_more_than_a_file_of_another_budget_that_reaches_it(name: str) -> None:
    other = encoded(name, "quality", 60)
    file = encoded(name, "psnr", error(name, other) - 0.01)
    assert len(file.data) <= len(other.data)


@pytest.mark.parametrize("size", [(1, 2), (3, 3), (1, 17), (5, 7), (64, 1)])
def test_tiny_pictures_use_what_they_are_given(size: tuple[int, int]) -> None:
    """A pixel needs as many bytes as a Gaussian has, not as many as samples."""
    pixels = np.random.default_rng(8).integers(0, 256, (*size, 3), np.uint8)
    assert encode(pixels, bytes=100_000, tune="psnr").stats.psnr > 30
    qualities = [encode(pixels, quality=quality, tune="psnr").stats.psnr for quality in (10, 60, 100)]
    assert sorted(qualities) == qualities
    assert qualities[-1] > 25


@pytest.mark.parametrize("size", [60, 150, 400])
def test_texture_is_within_the_bytes(size: int) -> None:
    assert len(encode(noise(), Budget("bytes", size), tune="visual").data) <= size


def test_little_effort_climbs_no_ladder() -> None:
    assert encoded("lines", "bytes", 400, effort=4).stats.steps < encoded("lines", "bytes", 400).stats.steps / 2


def test_a_photograph_needs_no_ladder() -> None:
    pixels = read_image_8_bit((PHOTOGRAPHS / "kodim23-crop.png").read_bytes())
    found = encode(pixels, Budget("bpp", 0.3), tune="psnr").stats
    assert found.steps < 2 * encode(pixels, Budget("bpp", 0.3), tune="psnr", effort=4).stats.steps


@pytest.mark.parametrize(("name", "kind", "value"), [("squares", "quality", 45), ("lines", "psnr", 35)])
def test_the_trace_goes_on_to_the_end(name: str, kind: BudgetKind, value: float) -> None:
    trace = encoded(name, kind, value).trace
    assert all(before.step <= after.step for before, after in pairwise(trace))
    assert trace[-1].step == trace[-1].steps


def test_what_does_not_have_enough_goes_on_to_the_ladder(monkeypatch: pytest.MonkeyPatch) -> None:
    y, x = np.mgrid[:48, :48]
    disc = np.where(((y - 24) ** 2 + (x - 24) ** 2 < 200)[..., None], (255, 255, 0), 0).astype(np.uint8)
    usual = encode(disc, bytes=250, tune="psnr").stats
    monkeypatch.setattr(Finish, "has_enough", lambda *_: False)
    further = encode(disc, bytes=250, tune="psnr").stats
    assert further.steps > 2 * usual.steps
    assert further.psnr >= usual.psnr
    assert further.bytes <= 250


@pytest.mark.parametrize(
    ("asked", "size", "db", "enough"),
    [
        ({"max_bytes": 1000}, 971, 40, True),
        ({"max_bytes": 1000}, 960, 40, False),
        ({"max_bytes": 1000}, 960, 60, True),  # as good as 8 bits allow
        ({"max_bytes": 60}, 53, 20, True),  # no room for another Gaussian
        ({"psnr": 40.0}, 500, 40, True),
        ({"psnr": 40.0}, 500, 39.9, False),
        ({"psnr": 70.0}, 500, 60, True),
        ({}, 500, 20, True),
    ],
)
def test_enough_is_what_the_budget_asks_for(asked: dict[str, Any], size: int, db: float, enough: bool) -> None:
    control = RateControl(RD, 4096, 0.1, **asked)
    finish = cast(Finish, SimpleNamespace(control=control, psnr=lambda _: db))
    stream = StreamV4(64, 64, 0.1, (0, 0, 0), False, True, bytes(size - HEADER_BYTES))
    assert Finish.has_enough(finish, stream) is enough


def test_bytes_that_a_fit_leaves_are_filled() -> None:
    """A fit that has only just begun leaves nearly all of them."""
    request = Request(squares(), Budget("bytes", 2000), "rd", "psnr", 5, 0, Recorder(Clock(), None))
    finish = Finish(place(request, RateControl.of(request, RD), shown_to_nobody), request)
    begun = finish.stream()
    assert not finish.has_enough(begun)
    filled = finish.searched([Found(begun, finish)], is_stiff=True)
    assert finish.has_enough(filled)
    assert len(container.serialise(filled)) <= 2000
    assert finish.psnr(filled) > finish.psnr(begun) + 1


def not_searched(finish: Finish, found: Sequence[Found], _: bool) -> StreamV4:
    return finish.best(found).stream


@pytest.mark.parametrize(("name", "db"), [("lines", 25), ("squares", 25), ("squares", 35)])
def test_a_search_finds_a_smaller_file_for_a_psnr(name: str, db: float, monkeypatch: pytest.MonkeyPatch) -> None:
    searched = encoded(name, "psnr", db)
    monkeypatch.setattr(Finish, "searched", not_searched)
    usual = encode(STIFF[name](), Budget("psnr", db), tune="psnr")
    assert len(searched.data) < 0.98 * len(usual.data)
    assert db <= error(name, searched) < db + 1
