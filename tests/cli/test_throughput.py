"""The throughput of several pictures, and the time left."""

from __future__ import annotations

import io
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sgmethod.cli.naming import Conversion
from sgmethod.cli.throughput import Throughput, pixels_of, throughput_text
from sgmethod.many.run import Tally
from tests.cli.conftest import PHOTO, Run

SIDES = {"tiny.png": 1, "small.png": 500, "large.png": 1000}  # of 0, 0.25 and 1 megapixel, and 0.1 to start each


@pytest.fixture(autouse=True)
def pictures(in_folder: None) -> None:  # noqa: ARG001
    for name, side in SIDES.items():
        Image.new("L", (side, side)).save(name)
    Path("broken.jpg").write_text("no picture")


@pytest.mark.parametrize(
    ("order", "left"),
    [
        (["large.png", "small.png", "tiny.png"], [", 4 s left", ", 1 s left", ", 0 s left"]),
        (["small.png", "large.png", "tiny.png"], ["", ", 1 s left", ", 0 s left"]),
        (["tiny.png", "large.png", "small.png"], ["", ", 3 s left", ", 0 s left"]),
        (["tiny.png"] * 3, [", 20 s left", ", 5 s left", ", 0 s left"]),
    ],
)
def test_the_rest_is_estimated_by_pixels_and_starts(order: list[str], left: list[str]) -> None:
    """Not before as much is done as an average picture: a picture of one pixel is no measure of large ones."""
    throughput = Throughput(order)
    for name, words in zip(order, left, strict=True):
        assert throughput.after(Conversion(name, name), Tally(encoded=10, seconds=10)) == f"1 pictures/s{words}"


def test_what_fails_is_no_measure_of_the_rest() -> None:
    """Nor is a picture without a header worth one pixel: it counts as an average one."""
    throughput = Throughput(["broken.jpg", "large.png", "large.png"])
    assert throughput.after(Conversion("a", "broken.jpg", error="no"), Tally(failed=1, seconds=1)) == "1 pictures/s"
    text = throughput.after(Conversion("b", "large.png"), Tally(encoded=1, failed=1, seconds=10))
    assert text == "5 s a picture, 10 s left"
    unknown = Throughput(["large.png", "broken.jpg", "broken.jpg"])
    text = unknown.after(Conversion("b", "large.png"), Tally(encoded=1, seconds=10))
    assert text == "10 s a picture, 20 s left"


@pytest.mark.parametrize(
    ("suffix", "package"), [("png", "PIL"), ("avif", "PIL"), ("heic", "pillow_heif"), ("jxl", "pillow_jxl")]
)
def test_pixels_of_every_kind(monkeypatch: pytest.MonkeyPatch, suffix: str, package: str) -> None:
    plugin = pytest.importorskip(package)
    if suffix == "heic":
        plugin.from_pillow(PHOTO).save("a.heic")
    else:
        PHOTO.save(f"a.{suffix}")
    monkeypatch.delitem(
        Image.OPEN, "HEIF", raising=False
    )  # which a program that reads a first picture has not registered
    assert pixels_of(f"a.{suffix}") == 128 * 96


@pytest.mark.parametrize(
    ("kind", "package"),
    [("png", "PIL"), ("webp", "PIL"), ("avif", "PIL"), ("heif", "pillow_heif"), ("jxl", "pillow_jxl")],
)
def test_no_picture_is_read_whole_for_its_size(monkeypatch: pytest.MonkeyPatch, kind: str, package: str) -> None:
    """A folder of them was read twice, perhaps from a network: WebP, AVIF, HEIC and JPEG XL by their readers."""
    plugin = pytest.importorskip(package)
    noise = Image.fromarray(np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8))
    if kind == "heif":
        plugin.from_pillow(noise).save("noise")
    else:
        noise.save("noise", kind)
    counted = Counted("noise")
    monkeypatch.setattr(Path, "open", lambda *_: counted)
    assert pixels_of("noise") == 400 * 300
    assert counted.taken <= 256 + 2**16 < Path("noise").stat().st_size


class Counted(io.FileIO):
    taken = 0

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        self.taken += len(data)
        return data


@pytest.mark.parametrize("command", ["encode", "preview"])
def test_pipes_into_a_folder(run: Run, command: str) -> None:
    """As from <(cat a.png) of a shell: each can be read once, and by no other process."""
    png = io.BytesIO()
    PHOTO.resize((32, 24)).save(png, "PNG")
    ends = [os.pipe() for _ in range(2)]
    for _, writer in ends:
        os.write(writer, png.getvalue())  # fits into the pipe's buffer
        os.close(writer)
    os.mkfifo("named.png")
    assert pixels_of("named.png") is None  # without waiting for its writer
    threading.Thread(target=Path("named.png").write_bytes, args=(png.getvalue(),), daemon=True).start()
    names = [*(f"/dev/fd/{reader}" for reader, _ in ends), "named.png"]
    ran = run(command, *names, "--output-dir", "out", "--bytes", "100", "--jobs", "2")
    assert (ran.status, ran.err) == (0, "")
    assert {path.name for path in Path("out").glob("*.sg")} == {*(f"{reader}.sg" for reader, _ in ends), "named.sg"}
    for reader, _ in ends:
        os.close(reader)


@pytest.mark.parametrize(
    ("per_second", "words"), [(0.0895, "11.2 s a picture"), (0.999, "1 s a picture"), (2.5, "2.5 pictures/s")]
)
def test_a_slow_pace_is_in_seconds(per_second: float, words: str) -> None:
    assert throughput_text(per_second) == words
