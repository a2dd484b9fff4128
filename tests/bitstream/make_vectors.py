"""Test vectors for decoders in other languages: python -m tests.bitstream.make_vectors

Writes docs/format/vectors.json: small files of version 2, and what each stage of the plain decoder makes of them. The
order of a stage's numbers stands at the head of the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sgmethod.bitstream.container import parse, serialise
from sgmethod.bitstream.texture import cells
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.io.files import write_atomically
from sgmethod.native import native
from sgmethod.scene import Gaussians
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.make_golden import FloatArray, colors_of, slanted
from tests.harness.data import ROOT

VECTORS = ROOT / "docs" / "format" / "vectors.json"
ORDER = {
    "integers": ["class", "column", "row", "y", "a", "b", "u", "v", "r", "px", "py", "X", "Y"],
    "gaussians": ["x", "y", "l1", "l2", "l3", "red", "green", "blue", "level"],
    "pixels": "hexadecimal, a string for each row: red, green and blue, and alpha if there is any",
    "texture": "codes by octave, row and column of cells",
}
Size = tuple[int, int]


def some_gaussians(n: int, size: Size, seed: int, *, grey: bool = False, upright: bool = False) -> Gaussians:
    """Ellipses of minor axes from a pixel to half of the picture."""
    rng = np.random.default_rng(seed)
    minor, aspect = np.geomspace(0.6, max(size) / 2, n), rng.uniform(1, 4, n)
    factors = slanted(minor, aspect, np.zeros(n) if upright else rng.uniform(0, np.pi, n))
    colors = colors_of(n) / 3
    return single(rng.uniform(0, 1, (n, 2)) * size, factors, colors[:, :1].repeat(3, 1) if grey else colors)


def single(*values: FloatArray) -> Gaussians:
    """Gaussians in single precision."""
    return Gaussians(*(value.astype(np.float32) for value in values))


def needles(n: int, size: Size) -> Gaussians:
    """Needles near 45 degrees, up to 300 times as long as wide."""
    rng = np.random.default_rng(3)
    angles = np.pi / 4 * rng.choice([-1, 1, 0.9, -1.1], n)
    factors = slanted(np.linspace(0.35, 0.6, n), np.geomspace(30, 300, n), angles)
    return single(rng.uniform(0.2, 0.8, (n, 2)) * size, factors, colors_of(n) / 4)


def file_of(
    gaussians: Gaussians, size: Size, quantum: float, *, grey: bool = False, is_short: bool = False, more: Any = None
) -> bytes:
    """The file of some Gaussians. more: changes the stream."""
    background = coded_background((120, 120, 120) if grey else (200, 120, 40), is_short)
    stream = StreamV2.of(gaussians, size, quantum, background, grey, is_short=is_short)
    return serialise(stream if more is None else more(stream))


def with_texture(stream: StreamV2) -> StreamV2:
    """The stream with a different strength in each cell."""
    shape = native.TEXTURE_OCTAVES, *cells(stream.width, stream.height)
    codes = (3 + 5 * np.arange(np.prod(shape))) % native.TEXTURE_STRENGTHS
    return replace(stream, texture=codes.reshape(shape).astype(np.uint8))


def with_alpha(stream: StreamV2) -> StreamV2:
    """The stream with an alpha of a few Gaussians, which leave 0 .. 1."""
    size = stream.width, stream.height
    gaussians = some_gaussians(5, size, 8, grey=True)
    gaussians.colors[:] = np.abs(gaussians.colors) * 8
    level = coded_background((60, 60, 60), stream.is_short)
    return replace(stream, alpha=StreamV2.of(gaussians, size, 0.1, level, grey=True, is_short=stream.is_short))


FILES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "empty": (
        "no Gaussians: the background alone",
        lambda: file_of(some_gaussians(0, (16, 9), 1), (16, 9), 0.3, is_short=True),
    ),
    "pixel": (
        "a single pixel; begin with the entropy decoder here",
        lambda: file_of(some_gaussians(1, (1, 1), 1), (1, 1), 0.3, is_short=True),
    ),
    "short": (
        "a short file: one state, narrower fields, a checksum of one byte",
        lambda: file_of(some_gaussians(20, (24, 16), 2), (24, 16), 0.1, is_short=True),
    ),
    "long": ("two states", lambda: file_of(some_gaussians(30, (32, 24), 3), (32, 24), 0.05)),
    "grey": (
        "no chroma in header and payload",
        lambda: file_of(some_gaussians(12, (20, 16), 4, grey=True), (20, 16), 0.1, grey=True),
    ),
    "upright": (
        "no shear in the payload",
        lambda: file_of(some_gaussians(16, (17, 23), 5, upright=True), (17, 23), 0.1, is_short=True),
    ),
    "needles": (
        "the finest steps, long numbers, extreme shapes",
        lambda: file_of(needles(10, (40, 32)), (40, 32), 0.0),
    ),
    "texture": (
        "two columns of cells, so that strengths change across the picture",
        lambda: file_of(some_gaussians(8, (72, 20), 6), (72, 20), 0.1, more=with_texture),
    ),
    "alpha": (
        "a fourth sample, from a payload of its own",
        lambda: file_of(some_gaussians(14, (26, 20), 7), (26, 20), 0.1, is_short=True, more=with_alpha),
    ),
}
VIEWS: dict[str, list[tuple[float, plain.Region]]] = {
    "long": [(0.5, (0, 0, 32, 24)), (1.7, (5, 3, 11, 9))],
    "texture": [(0.4, (0, 0, 72, 20)), (2.0, (30, 1, 9, 7))],
}


def vector(name: str) -> dict[str, Any]:
    """Every stage of a file."""
    shows, make = FILES[name]
    data = make()
    file = plain.read(data)
    found: dict[str, Any] = {"name": name, "shows": shows, "bytes": data.hex(), "header": header_of(file)}
    if file.codes:
        found["texture"] = file.codes
    found |= layer(file.header, file.payload, file.integers())
    if file.alpha is not None:
        found["alpha"] = {**fields(file.alpha[0]), **layer(*file.alpha, file.alpha_integers())}
    found["pixels"] = picture(plain.decode(data))
    if name in VIEWS:
        found["views"] = [
            {"scale": scale, "region": region, "pixels": picture(plain.view(data, scale, region))}
            for scale, region in VIEWS[name]
        ]
    return found


def header_of(file: plain.File) -> dict[str, Any]:
    """The header's fields."""
    h = file.header
    flags = {"grey": h.grey, "upright": h.upright, "texture": bool(file.codes), "alpha": file.alpha is not None}
    return {**flags, "short": h.is_short, "width": h.width, "height": h.height, **fields(h)}


def fields(header: plain.Header) -> dict[str, Any]:
    """What a picture and its alpha have in common."""
    return {"quantum": header.quantum, "background": header.background}


def layer(header: plain.Header, payload: bytes, integers: list[plain.Integers]) -> dict[str, Any]:
    """A payload, its integers and its Gaussians."""
    gaussians = [plain.gaussian_of(header, one) for one in integers]
    return {
        "payload": payload.hex(),
        "integers": [
            [one.of_class.k, *plain.deinterleave(one.cell), *one.colour, *one.shape, *one.parts, *one.place]
            for one in integers
        ],
        "gaussians": [[*g[:5], *g[5], plain.level_of(*g[2:5])] for g in gaussians],
    }


def picture(drawn: tuple[int, int, bytes]) -> list[str]:
    """The rows of a picture."""
    _, height, samples = drawn
    row = len(samples) // height
    return [samples[at : at + row].hex() for at in range(0, len(samples), row)]


def text() -> str:
    """All vectors as JSON, a list of plain values in a line."""
    vectors = {"version": 2, "order": ORDER, "files": [vector(name) for name in FILES]}
    assert all(serialise(parse(bytes.fromhex(one["bytes"]))).hex() == one["bytes"] for one in vectors["files"])
    return indented(vectors) + "\n"


def indented(value: Any, indent: str = "") -> str:
    """JSON in which only what holds lists or objects goes over several lines."""
    parts = list(value.values()) if isinstance(value, dict) else value
    if not isinstance(value, dict | list) or not any(isinstance(part, dict | list) for part in parts):
        if isinstance(value, list) and len(json.dumps(value)) > 400:  # rows of pixels
            return "[\n" + ",\n".join(f"{indent} {json.dumps(part)}" for part in value) + f"\n{indent}]"
        return json.dumps(value)
    inner = [indented(part, indent + " ") for part in parts]
    if isinstance(value, dict):
        inner = [f"{json.dumps(key)}: {part}" for key, part in zip(value, inner, strict=True)]
    begin, end = "{}" if isinstance(value, dict) else "[]"
    return begin + "\n" + ",\n".join(f"{indent} {part}" for part in inner) + f"\n{indent}{end}"


if __name__ == "__main__":
    write_atomically(VECTORS, text().encode())
