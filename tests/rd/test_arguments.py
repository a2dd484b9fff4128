"""Numbers, sequences, arrays and paths as programs have them: each is what it is, or refused with an SgError."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod import Budget, BudgetError, ImageError, SgError, View, ViewError
from sgmethod.io.image import read_input
from tests.support.data import golden_path
from tests.support.profiles import OTHER, shorten

GOLDEN = golden_path("v2-color.sg").read_bytes()  # 48 x 40
PIXELS = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)
INTEGERS = [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64]


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch, 20)


@pytest.mark.parametrize("kind", INTEGERS)
def test_a_budget_is_pythons_own(kind: type[np.integer]) -> None:
    for budget in (Budget("quality", kind(30)), Budget("bytes", kind(30)), Budget("psnr", kind(30))):
        assert (type(budget.value), budget.value) == (int, 30)
    assert Budget("bytes", kind(100)).max_bytes(768, 512) == 100
    assert Budget("bpp", kind(2)).max_bytes(768, 512) == 98304
    assert sgmethod.encode(PIXELS, psnr=kind(30)).data == sgmethod.encode(PIXELS, psnr=30).data


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64, np.longdouble, Fraction])
def test_a_budget_of_a_small_float_does_not_overflow(kind: type) -> None:
    budget = Budget("bpp", kind(0.25))
    assert type(budget.value) is float
    assert budget.max_bytes(768, 512) == 12288


@pytest.mark.parametrize(
    ("text", "size"),
    [("20k", 20_000), ("500", 500), ("1.5MB", 1_500_000), ("1 KiB", 1024), ("1.001kb", 1001), ("2.b", 2)],
)
def test_a_size_may_be_a_text(text: str, size: int) -> None:
    assert Budget("bytes", text) == Budget("bytes", size)


@pytest.mark.parametrize("kind", [*INTEGERS, int])
def test_a_region_is_pythons_own(kind: type) -> None:
    part = [kind(n) for n in (10, 11, 30, 20)]
    expected = sgmethod.decode(GOLDEN, view=View(8, (10, 11, 30, 20)))
    assert expected.shape == (160, 240, 3)
    for region in (tuple(part), part, np.array(part), iter(part)):
        view = View(kind(8), region, texture=np.True_)  # type: ignore[arg-type]
        assert view == View(8, (10, 11, 30, 20))
        assert {type(n) for n in (view.scale, *(view.region or ()))} == {int}
        assert np.array_equal(sgmethod.decode(GOLDEN, view=view), expected)
    assert View(2, (kind(100), kind(0), kind(100), kind(100))).size(200, 100) == (200, 200)  # 100 + 100 in int8: -56


@pytest.mark.usefixtures("set_threads")
def test_other_arguments_are_pythons_own() -> None:
    expected = sgmethod.encode(PIXELS, bytes=300, effort=4).data
    assert sgmethod.encode(PIXELS, bytes=np.uint16(300), effort=np.int8(4)).data == expected
    assert sgmethod.encode(PIXELS, bytes="0.3k", effort=4).data == expected
    assert sgmethod.preview(PIXELS, "0.1k") == sgmethod.preview(PIXELS, np.uint8(100))
    assert sgmethod.encode(PIXELS, bytes=300, time_limit_s=np.float16(9)).stats.bytes <= 300
    assert sgmethod.decode(GOLDEN, np.uint16(48 * 40)).shape == (40, 48, 3)
    view = View(np.float16(0.5), prefix=np.float16(0.5))
    assert (view, type(view.scale), type(view.prefix)) == (View(0.5, prefix=0.5), float, float)
    assert sgmethod.info(GOLDEN, np.int32(9000)) == sgmethod.info(GOLDEN)
    sgmethod.set_threads(np.uint8(2))
    assert sgmethod.native.native.thread_count() == 2


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: sgmethod.encode(None), ImageError, "numpy array, not NoneType"),
        (lambda: sgmethod.encode([[1]]), ImageError, "not list"),
        (lambda: sgmethod.encode(Image.new("RGB", (0, 4))), ImageError, "empty"),
        (lambda: sgmethod.encode(np.float32([[0, 255]])), ImageError, "must lie in [0, 1], got 0 to 255: rescale"),
        (lambda: sgmethod.encode(np.array([[-0.5, 1.0000001]])), ImageError, "got -0.5 to 1.0000001"),
        (lambda: sgmethod.encode(np.array([[0, math.nan]])), ImageError, "must lie in [0, 1], got NaN"),
        (lambda: sgmethod.encode(PIXELS, 0.3), BudgetError, "bpp=0.3"),
        (lambda: sgmethod.encode(PIXELS, bpp="0.3"), BudgetError, "positive number, got '0.3'"),
        (lambda: sgmethod.encode(PIXELS, bytes="20g"), BudgetError, "such as 20000, 20k or 1.5MB, not '20g'"),
        (lambda: sgmethod.encode(PIXELS, bytes="20ki"), BudgetError, "not '20ki'"),
        (lambda: sgmethod.encode(PIXELS, bytes="2_0k"), BudgetError, "not '2_0k'"),
        (lambda: sgmethod.encode(PIXELS, bytes="\uff12\uff10k"), BudgetError, "such as 20000"),
        (lambda: sgmethod.encode(PIXELS, bytes="20\u212a"), BudgetError, "such as 20000"),
        (lambda: sgmethod.encode(PIXELS, bytes="0.5"), BudgetError, "bytes must be a whole number, got 0.5"),
        (lambda: sgmethod.encode(PIXELS, bytes="-1k"), BudgetError, "bytes must be a positive number, got '-1k'"),
        (lambda: sgmethod.encode(PIXELS, quality="best"), BudgetError, "or one of preview, web, archive, got 'best'"),
        (lambda: sgmethod.preview(PIXELS, bytes="20k"), BudgetError, "from 12 to 16384, got 20000"),
        (lambda: sgmethod.encode(PIXELS, bpp=0.3, psnr=30), BudgetError, "give one budget, not 2: bpp, psnr"),
        (lambda: sgmethod.encode(PIXELS, Budget("bpp", 1), bpp=0.3), BudgetError, "not 2"),
        (lambda: sgmethod.encode(PIXELS, profile="poster"), BudgetError, "unknown profile"),
        (lambda: sgmethod.encode(PIXELS, tune="best"), BudgetError, "unknown tune"),
        (lambda: sgmethod.encode(PIXELS, psnr=20, tune="visual"), BudgetError, "a budget in dB"),
        (lambda: sgmethod.encode(PIXELS, psnr=20, tune="fidelity"), BudgetError, "a budget in dB"),
        (lambda: sgmethod.encode(PIXELS, profile=OTHER, tune="visual"), BudgetError, f"profile {OTHER}"),
        (lambda: sgmethod.encode(PIXELS, profile=OTHER, quality="web"), BudgetError, "cannot aim at a quality"),
        (lambda: sgmethod.encode(PIXELS, profile=OTHER, effort=6), BudgetError, "only profile rd has an effort"),
        (lambda: sgmethod.encode(PIXELS, time_limit_s=0.0), BudgetError, "time limit"),
        (lambda: sgmethod.encode(PIXELS, time_limit_s=-1.0), BudgetError, "time limit"),
        (lambda: sgmethod.encode(PIXELS, time_limit_s=math.inf), BudgetError, "time limit"),
        (lambda: sgmethod.encode(PIXELS, time_limit_s=10**400), BudgetError, "time limit"),
        (lambda: sgmethod.encode(PIXELS, time_limit_s=np.float16("nan")), BudgetError, "time limit"),
        (lambda: sgmethod.encode(PIXELS, profile=["rd"]), BudgetError, "unknown profile"),
        (lambda: sgmethod.encode(PIXELS, bpp=np.array([0.3, 0.4])), BudgetError, "bpp must be a positive number"),
        (lambda: Budget("bpp", Fraction(10**400)), BudgetError, "bpp must be a positive number"),
        (lambda: sgmethod.encode("missing.jpg"), FileNotFoundError, "missing.jpg"),
        (lambda: sgmethod.decode("missing.sg"), FileNotFoundError, "missing.sg"),
        (lambda: sgmethod.decode(5), SgError, "a path or bytes, not int"),
        (lambda: sgmethod.info(None), SgError, "not NoneType"),
        (lambda: sgmethod.open(b"\xd3"), SgError, "too short"),
        (lambda: sgmethod.open(GOLDEN).pixels(scale="big"), ViewError, "got 'big'"),
        (lambda: sgmethod.open(GOLDEN).pixels(region=(0.5, 0, 3, 3)), ViewError, "four whole numbers"),
        (lambda: sgmethod.open(GOLDEN).pixels(prefix=None), ViewError, "got None"),
        (lambda: sgmethod.open(GOLDEN).pixels(region=5), ViewError, "four whole numbers"),
        (lambda: sgmethod.open(GOLDEN).pixels(region="1234"), ViewError, "four whole numbers"),
        (lambda: sgmethod.open(GOLDEN).pixels(region=np.array([[1, 2], [3, 4]])), ViewError, "four whole numbers"),
        (lambda: sgmethod.open(GOLDEN).pixels(scale=10**400), ViewError, "scale must be between"),
        (lambda: sgmethod.View(scale=20).size(65535, 1), ViewError, "at most 1,048,576 pixels a side"),
        (lambda: Budget("gaussians", 2**24 + 1).max_gaussians(65535, 65535), BudgetError, "16777216 that a file can"),
        (lambda: sgmethod.decode(GOLDEN, view=(1, None)), ViewError, "sgmethod.View, not tuple"),
        (lambda: sgmethod.decode(GOLDEN, View(0.5)), ViewError, "give a view by its name, view=View(...)"),
        (lambda: sgmethod.decode(GOLDEN, view=View(0.5), width=9), ViewError, "scale cannot be combined"),
        (lambda: sgmethod.decode(GOLDEN, width=0), ViewError, "a width or height must be a whole number"),
        (lambda: sgmethod.decode(GOLDEN, "many"), SgError, "max_pixels must be a whole number"),
        (lambda: sgmethod.info(GOLDEN, -1), SgError, "max_gaussians must be a whole number"),
        (lambda: sgmethod.set_threads(0), SgError, "threads must be a whole number from 1 to 256, got 0"),
        (lambda: sgmethod.set_threads(1.5), SgError, "got 1.5"),
        (lambda: sgmethod.encode("photo\0.jpg"), SgError, "'photo\\x00.jpg' is not a valid file name"),
        (lambda: sgmethod.decode("photo\ud800.sg"), SgError, "is not a valid file name"),
        (lambda: sgmethod.encode(PIXELS, bytes=99).save("photo\0.sg"), SgError, "is not a valid file name"),
    ],
)
def test_others_are_refused(call: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error) as caught:
        call()
    assert words in str(caught.value)


def test_arrays_of_every_byte_order_and_layout_are_what_they_are() -> None:
    deep, part = PIXELS.astype(np.uint16) * 257, PIXELS / 255
    padded = np.zeros((22, 40, 5), np.uint8)
    padded[1:21, 3:33, 1:4] = PIXELS
    alpha = np.dstack([PIXELS, PIXELS[..., :1]])
    layouts = {
        "Fortran's order": np.asfortranarray(PIXELS),
        "planes": np.ascontiguousarray(PIXELS.transpose(2, 0, 1)).transpose(1, 2, 0),
        "backwards": np.ascontiguousarray(PIXELS[::-1, ::-1, ::-1])[::-1, ::-1, ::-1],
        "a part": padded[1:21, 3:33, 1:4],
        "read only": np.frombuffer(PIXELS.tobytes(), np.uint8).reshape(PIXELS.shape),
        "uint16, big end first": deep.astype(">u2"),
        "uint16, little end first": deep.astype("<u2"),
        **{kind: part.astype(kind) for kind in (">f4", ">f8", "<f4", "<f8", ">f2", np.longdouble)},
    }
    for name, array in layouts.items():
        assert np.array_equal(read_input(array), PIXELS), name
    assert np.array_equal(read_input(PIXELS[..., 0].view(np.matrix)), np.repeat(PIXELS[..., :1], 3, 2))
    assert np.array_equal(read_input((alpha.astype(np.uint16) * 257).astype(">u2"), keep_alpha=True), alpha)


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 18)])
@pytest.mark.parametrize(("channels", "least"), [(3, 12), (4, 15)])
def test_a_picture_too_small_for_the_usual_budget_gets_the_smallest_file(
    size: tuple[int, int], channels: int, least: int
) -> None:
    pixels = np.full((*size, channels), 90, np.uint8)
    assert sgmethod.encode(pixels).stats.bytes <= least  # of the largest picture
    with pytest.raises(BudgetError, match=f"at least {least} bytes"):
        sgmethod.encode(pixels, bpp=0.3)
