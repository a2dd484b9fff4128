"""The package as a Python program meets it: what it takes, what it gives, Pillow's side of it, the examples."""

from __future__ import annotations

import doctest
import io
import subprocess
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, UnidentifiedImageError

import sgmethod
from service.api.requests import BITSTREAM_TYPE
from sgmethod import Budget, BudgetError, SgError, SgFile, View
from sgmethod.budget import DEFAULT_BUDGET
from sgmethod.threads import in_parallel
from tests.io import profiles
from tests.io.test_image import exif_with
from tests.support.data import golden_path
from tests.support.pictures import photo
from tests.support.profiles import OTHER, shorten

PIXELS = photo()  # 128 x 96
PHOTO = Image.fromarray(PIXELS)
GOLDEN = golden_path("v2-color.sg").read_bytes()  # 48 x 40


@pytest.fixture(autouse=True)
def in_folder(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """photo.jpg too, and encodes of less than a second."""
    PHOTO.save(files / "photo.jpg", quality=95)
    shorten(monkeypatch, 60)


def encoded(image: Any) -> bytes:
    return sgmethod.encode(image, bytes=500).data


def test_every_form_of_a_picture_is_the_same_picture() -> None:
    expected = encoded(PIXELS)
    forms = ["photo.png", Path("photo.png"), Path("photo.png").read_bytes(), bytearray(Path("photo.png").read_bytes())]
    forms += [PHOTO, Image.open("photo.png"), PIXELS.astype(np.uint16) * 257, PIXELS / 255]
    forms += [(PIXELS / 255).astype(np.float32), np.dstack([PIXELS, np.full(PIXELS.shape[:2], 255, np.uint8)])]
    forms += [PIXELS[:, ::-1].copy()[:, ::-1]]  # not contiguous
    for form in forms:
        assert encoded(form) == expected


def test_grey_is_three_equal_channels() -> None:
    grey = PIXELS[..., 1]
    expected = encoded(np.repeat(grey[..., None], 3, 2))
    for form in (grey, grey[..., None], Image.fromarray(grey), Image.fromarray(grey).convert("LA")):
        assert encoded(form) == expected


def test_transparency_is_kept_whatever_the_form() -> None:
    alpha = np.tile(np.arange(128, dtype=np.uint8) * 2, (96, 1))[..., None]
    both = np.concatenate([PIXELS, alpha], 2)
    expected = encoded(both)
    assert sgmethod.decode(expected).shape == (96, 128, 4)
    Image.fromarray(both).save("clear.png")
    for form in (Image.fromarray(both), both / 255, both.astype(np.uint16) * 257, "clear.png"):
        assert encoded(form) == expected


def test_pictures_of_pillow_are_taken_as_they_are_seen() -> None:
    image = Image.open("photo.png")
    image.info["icc_profile"] = profiles.rgb(profiles.DISPLAY_P3)
    image.save("p3.png")
    assert encoded(image) == encoded("p3.png") != encoded(PIXELS)
    PHOTO.save("turned.png", exif=exif_with(6))
    assert encoded(Image.open("turned.png")) == encoded("turned.png") == encoded(np.rot90(PIXELS, -1))


def test_budgets() -> None:
    assert sgmethod.encode(PIXELS, effort=1).data == sgmethod.encode(PIXELS, DEFAULT_BUDGET, effort=1).data
    assert sgmethod.encode(PIXELS, Budget("bytes", 500)).data == encoded(PIXELS)


def test_files_by_path_and_bytes() -> None:
    pixels = sgmethod.decode(GOLDEN)
    for file in ("picture.sg", Path("picture.sg"), bytearray(GOLDEN), memoryview(GOLDEN)):
        assert np.array_equal(sgmethod.decode(file), pixels)
        assert sgmethod.info(file) == sgmethod.info(GOLDEN)
    picture = sgmethod.open("picture.sg")
    assert (picture.size, picture.info) == ((48, 40), sgmethod.info(GOLDEN))
    assert np.array_equal(picture.pixels(), pixels)
    view = View(0.5, (3, 5, 20, 11), 0.7)
    assert np.array_equal(picture.pixels(0.5, (3, 5, 20, 11), 0.7), sgmethod.decode(GOLDEN, view=view))
    part = View(region=(3, 5, 20, 11), texture=False)
    for side in ({"width": 30}, {"height": 30}, {"width": 10, "height": 9}):
        assert np.array_equal(sgmethod.decode(GOLDEN, **side), picture.pixels(**side))
        expected = picture.pixels(region=(3, 5, 20, 11), texture=False, **side)
        assert np.array_equal(sgmethod.decode(GOLDEN, view=part, **side), expected)
    assert repr(picture) == f"<SgFile 48 x 40 pixels, {len(GOLDEN)} bytes>"


def test_what_is_shown_is_short_and_what_is_listed_is_all() -> None:
    result = sgmethod.encode(PIXELS, bytes=500)
    assert len(repr(result)) < 300
    assert set(sgmethod.__all__) <= set(dir(sgmethod))
    result.save("out.sg")
    assert Path("out.sg").read_bytes() == result.data
    for other in ("out.tif", "out.jp2", "out.psd", "out.svg"):
        with pytest.raises(SgError, match="names a picture"):
            result.save(other)
    with pytest.raises(SgError, match=r"out\.JPG names a picture, .* use out\.sg"):
        result.save("out.JPG")
    result.save("out.sg.part")
    assert {path.name for path in Path().glob("out*")} == {"out.sg", "out.sg.part"}


def test_importing_takes_neither_numpy_nor_torch() -> None:
    command = "import sys, sgmethod; print(*{'numpy', 'torch', 'importlib.metadata'} & sys.modules.keys())"
    ran = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert ran.stdout == "\n"


WITHOUT_EXTRAS = f"""
import sys
for name in ("httpx2", "torch"):
    sys.modules[name] = None  # to import it is an ImportError
import numpy, sgmethod
picture = numpy.zeros((8, 8), numpy.uint8)
for use in (
    "from sgmethod.client import Client",
    "import sgmethod.torch",
    "sgmethod.encode(picture, profile={OTHER!r})",
):
    try:
        exec(use)
    except sgmethod.MissingPackageError as error:
        assert isinstance(error, ImportError)
        print(str(error).partition(": ")[2])
"""


def test_a_missing_extra_is_named() -> None:
    ran = subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], capture_output=True, text=True, check=True)
    extras = ("client", "torch", "torch")
    assert ran.stdout.split("pip install ")[1:] == [f"'sgmethod[{name}]'\n" for name in extras]


WITH_OPENCV = """
import importlib, sys, types
import numpy, sgmethod
kind, picture = sys.argv[1], numpy.arange(768, dtype=numpy.uint8).reshape(16, 16, 3)
if kind == "plain":
    import cv2
    del cv2.ximgproc
else:
    sys.modules["cv2"] = types.ModuleType("cv2") if kind == "empty" else None
for _ in range(2):
    try:
        print(len(sgmethod.encode(picture, bytes=100, effort=1).data) <= 100)
    except sgmethod.MissingPackageError as error:
        print(error)
"""


@pytest.mark.parametrize("kind", ["plain", "missing", "empty"])
def test_any_opencv_will_do(kind: str) -> None:
    """Even without contributed modules; where there is none, or only its folder, the message says what to install."""
    ran = subprocess.run([sys.executable, "-c", WITH_OPENCV, kind], capture_output=True, text=True, check=True)
    for line in ran.stdout.splitlines():
        if kind == "plain":
            assert line == "True"
        else:
            assert line.startswith("OpenCV, which encoding needs, cannot be imported (")
            assert line.endswith("opencv-contrib-python-headless")
    assert len(ran.stdout.splitlines()) == 2


def test_a_warning_points_at_the_callers_line() -> None:
    clear = Image.new("RGBA", PHOTO.size, (90, 120, 60, 100))  # any fit is good, however few steps there is time for
    clear.save("clear.png")
    sgmethod.encode(np.zeros((8, 8, 3), np.uint8), profile=OTHER, gaussians=1)  # loads PyTorch, which counts
    settings = {"profile": OTHER, "gaussians": 4, "time_limit_s": 1}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        first = sys._getframe().f_lineno + 1
        sgmethod.encode("clear.png", **settings)
        sgmethod.encode(clear, **settings)
        sgmethod.encode(np.asarray(clear), **settings)
        sgmethod.pack(sgmethod.open(GOLDEN).gaussians(), 128, 96, bpp=5, image="clear.png")
        clear.save("clear.sg", **settings)
    expected = [(__file__, line) for line in range(first, first + 5)]
    assert [(warning.filename, warning.lineno) for warning in caught] == expected


def test_pillow_opens_and_saves() -> None:
    """In a process that has imported the package alone."""
    command = (
        "import sgmethod\nfrom PIL import Image\n"
        "image = Image.open('picture.sg')\nprint(image.format, image.mode, image.size)\nimage.save('picture.png')\n"
    )
    ran = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert ran.stdout == "SGM RGB (48, 40)\n"
    with Image.open("picture.sg") as image:
        assert image.get_format_mimetype() == BITSTREAM_TYPE
    assert np.array_equal(np.asarray(Image.open("picture.png")), sgmethod.decode(GOLDEN))
    PHOTO.save("out.sg", bytes=500, compress_level=3)
    assert Path("out.sg").read_bytes() == encoded(PIXELS)
    file = io.BytesIO()
    PHOTO.save(file, "SGM", budget=Budget("bytes", 500))
    assert file.getvalue() == encoded(PIXELS)
    with pytest.raises(BudgetError):
        PHOTO.save("none.sg", bpp=-1)
    assert not Path("none.sg").exists()
    clear = PHOTO.resize((32, 24)).convert("RGBA")
    clear.putalpha(100)
    clear.save("clear.sg", bytes=100)
    with Image.open("clear.sg") as image:
        assert image.mode == "RGBA"
        assert np.array_equal(np.asarray(image), sgmethod.decode("clear.sg"))


def test_pillow_draws_small_pictures_small(monkeypatch: pytest.MonkeyPatch) -> None:
    scales, real = [], SgFile.pixels

    def spy(self: SgFile, scale: float) -> Any:
        scales.append(scale)
        return real(self, scale)

    monkeypatch.setattr(SgFile, "pixels", spy)
    image = Image.open("picture.sg")
    image.thumbnail((12, 12))
    assert image.size == (12, 10)
    assert scales == [0.6]  # 24 pixels of 40: twice the size that is needed, as Pillow asks
    whole = Image.open("picture.sg").resize((12, 10))
    assert np.abs(np.asarray(image).astype(int) - np.asarray(whole)).mean() < 3  # seen: 0.6
    again = Image.open("picture.sg")
    assert again.draft("L", (1000, 1000)) == ("RGB", (0, 0, 48, 40))
    again.load()
    assert again.draft(None, (1, 1)) is None
    assert again.size == (48, 40)


def test_pillow_raises_its_own_errors() -> None:
    for data in (GOLDEN[:-9], GOLDEN[:-1] + b"x", b"\xd3\xc9" + GOLDEN[2:]):
        with pytest.raises(UnidentifiedImageError, match=r"checksum|version 9 "):
            Image.open(io.BytesIO(data))


WITH_EXAMPLES = ["codec", "decoder", "pillow.plugin", "exchange.packing", "previews.preview", "previews.reducing"]


@pytest.mark.parametrize("module", [*WITH_EXAMPLES, "torch.drawing", "torch.reading", "torch.fitting"])
def test_examples_in_docstrings(module: str) -> None:
    sgmethod.encode("photo.jpg").save("photo.sg")
    names = {"sgmethod": sgmethod, "np": np, "Image": Image}
    with warnings.catch_warnings(record=True) as caught:
        ran = doctest.testmod(__import__(f"sgmethod.{module}", fromlist=["x"]), extraglobs=names)
    assert ran.attempted > 0
    assert (ran.failed, caught) == (0, [])


@pytest.mark.usefixtures("set_threads")
def test_results_are_in_order_and_made_by_as_many_threads_as_set() -> None:
    sgmethod.set_threads(2)
    both = threading.Barrier(2)
    names = in_parallel(lambda _: (both.wait(60), threading.current_thread().name)[1], range(2))
    assert len(set(names)) == 2
    for threads in (2, 1):
        sgmethod.set_threads(threads)
        assert in_parallel(lambda n: n * n, range(50)) == [n * n for n in range(50)]
        with pytest.raises(ZeroDivisionError):
            in_parallel(lambda n: 1 // n, [1, 0, 2])
    assert in_parallel(lambda _: threading.current_thread(), range(3)) == [threading.current_thread()] * 3
