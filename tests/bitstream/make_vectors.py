"""Test vectors for decoders in other languages: python -m tests.bitstream.make_vectors

Writes docs/format/vectors.json: small files of version 2, what the plain decoder makes of them, what is drawn, parts of
payloads, and files to refuse. The order of a stage's numbers stands at the head of the file.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod import View, decode
from sgmethod.bitstream.container import parse, serialise
from sgmethod.bitstream.texture import cells
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.io.files import write_atomically
from sgmethod.native import native
from sgmethod.native.reference import level_of
from sgmethod.scene import Gaussians
from tests.backend.cases import single
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.make_golden import Size, colors_of, slanted
from tests.bitstream.make_refused import MANY, refused, refused_early
from tests.harness.data import ROOT

VECTORS = ROOT / "docs" / "format" / "vectors.json"
ORDER = {
    "integers": ["class", "column", "row", "y", "a", "b", "u", "v", "r", "px", "py", "X", "Y"],
    "gaussians": ["x", "y", "l1", "l2", "l3", "red", "green", "blue", "level"],
    "pixels": "hexadecimal, a string for each row: red, green and blue, and alpha if there is any",
    "texture": "codes by octave, row and column of patches",
    "parts": ["bytes of the payload, at most all", "how many of the first Gaussians they hold; null: refuse"],
    "notes": "column and row: as in the file, with the margin; gaussians: binary32, to be met exactly",
}


def some_gaussians(n: int, size: Size, seed: int, *, grey: bool = False, upright: bool = False) -> Gaussians:
    """Ellipses of minor axes from a pixel to half of the picture."""
    rng = np.random.default_rng(seed)
    minor, aspect = np.geomspace(0.6, max(size) / 2, n), rng.uniform(1, 4, n)
    factors = slanted(minor, aspect, np.zeros(n) if upright else rng.uniform(0, np.pi, n))
    colors = colors_of(n) / 3
    return single(rng.uniform(0, 1, (n, 2)) * size, factors, colors[:, :1].repeat(3, 1) if grey else colors)


def needles(n: int, size: Size) -> Gaussians:
    """Needles near 45 degrees, up to 300 times as long as wide."""
    rng = np.random.default_rng(3)
    angles = np.pi / 4 * rng.choice([-1, 1, 0.9, -1.1], n)
    factors = slanted(np.linspace(0.35, 0.6, n), np.geomspace(30, 300, n), angles)
    return single(rng.uniform(0.2, 0.8, (n, 2)) * size, factors, colors_of(n) / 4)


def dots() -> Gaussians:
    """Round Gaussians of every class from -4, so many that some models adapt at their slowest."""
    n = 320
    rng = np.random.default_rng(11)
    size = np.geomspace(0.24, 3, n)
    colors = rng.choice([-1, 1], (n, 1)) * rng.uniform(0.3, 0.6, (n, 1)) / np.maximum(size, 0.4)[:, None]
    factors = slanted(size, rng.uniform(1, 1.3, n), rng.uniform(0, np.pi, n))
    return single(rng.uniform(0, 1, (n, 2)) * (40, 36), factors, colors.repeat(3, 1))


AT_LIMITS = [  # class, y, and V, R, U as parts of their range
    (0, 2**22, 0.0, 0.0, 0.3),
    (0, 2**19, 0.25, 1.0, -0.3),
    (5, -(2**15), -1.0, 3.0, 0.1),
    (-4, 40, -1.0, 0.5, 0.2),
    (-4, -40, 1.0, -1.5, -0.2),
    (-3, 9, 3.0, 2.0, 0.4),
    (1, 6, 8.0, -0.5, 0.0),
    (1, 7, -8.0, 4096.0, 0.0),
    (9, 2**20, 2.0, -4096.0, -0.4),
    (14, 3000, 0.5, -0.5, 0.4),
    (28, 700_000, 0.25, 1.0, -0.4),
    (3, 2**18, 17254 / 2**18, 0.0, 2706.5 / 4096 - 0.5),  # l3 = 2.8: its level is another once it is rounded
    (5, 2**18, 45 / 2**10, 0.25, 0.0),
]


def at_limits() -> Gaussians:
    """Gaussians of which colour, shape or size meets a limit of the format, in the finest of files."""
    rng = np.random.default_rng(12)
    k, y, v, r, u = (np.array(column) for column in zip(*AT_LIMITS, strict=True))
    size = 2.0 ** (k / 2)
    l1, l3 = size * np.exp(u * np.log(2) / 2 + v), size * np.exp(u * np.log(2) / 2 - v)
    step = np.maximum(2.0**-10 / (1.5 * size), plain.LEAST_COLOUR_STEP) / np.sqrt(3)
    l2 = r * np.maximum(l3, 0.3) * l1 / np.maximum(l1, 0.3)  # the encoder keeps l2 / l1
    factors, colors = np.stack([l1, l2, l3], 1), (y * step)[:, None].repeat(3, 1)
    return single(rng.uniform(0, 1, (len(k), 2)) * (20, 14), factors, colors)


def far_apart() -> Gaussians:
    """In a picture so wide that its columns are limited: 32 Gaussians of class 0 and one of class -4."""
    rng = np.random.default_rng(13)
    means = np.concatenate([[(65_530, 32_000), (65_534.3, 32_760.2), (0.4, 0.3)], rng.uniform(0, 1, (30, 2)) * FAR])
    size = np.array([0.25, *[1.0] * 32])[:, None]
    return single(means, size * (1, 0.1, 1), rng.normal(0, 0.3, (33, 3)))


FAR = (65_535, 32_762)


def file_of(
    gaussians: Gaussians, size: Size, quantum: float, *, grey: bool = False, is_short: bool = False, more: Any = None
) -> bytes:
    """The file of some Gaussians. more: changes the stream."""
    background = coded_background((120, 120, 120) if grey else (200, 120, 40), is_short)
    stream = StreamV2.of(gaussians, size, quantum, background, grey, is_short=is_short)
    return serialise(stream if more is None else more(stream))


def with_texture(stream: StreamV2) -> StreamV2:
    """The stream with a different strength in each patch."""
    shape = native.TEXTURE_OCTAVES, *cells(stream.width, stream.height)
    codes = (3 + 5 * np.arange(np.prod(shape))) % native.TEXTURE_STRENGTHS
    return replace(stream, texture=codes.reshape(shape).astype(np.uint8))


def with_alpha(stream: StreamV2, quantum: float = 0.1) -> StreamV2:
    """The stream with an alpha of a few Gaussians, which leave 0 .. 1."""
    size = stream.width, stream.height
    gaussians = some_gaussians(5, size, 8, grey=True)
    gaussians.colors[:] = np.abs(gaussians.colors) * 8
    level = coded_background((60, 60, 60), stream.is_short)
    return replace(stream, alpha=StreamV2.of(gaussians, size, quantum, level, grey=True, is_short=stream.is_short))


def some_file(
    n: int, size: Size, seed: int, quantum: float, *, grey: bool = False, upright: bool = False, **more: Any
) -> bytes:
    return file_of(some_gaussians(n, size, seed, grey=grey, upright=upright), size, quantum, grey=grey, **more)


FILES: dict[str, tuple[str, bytes]] = {
    "empty": ("no Gaussians: the background alone", some_file(0, (16, 9), 1, 0.3, is_short=True)),
    "pixel": ("a single pixel; begin with the entropy decoder here", some_file(1, (1, 1), 1, 0.3, is_short=True)),
    "short": (
        "a short file: one state, narrower fields, a checksum of one byte",
        some_file(20, (24, 16), 2, 0.1, is_short=True),
    ),
    "long": ("two states", some_file(30, (32, 24), 3, 0.05)),
    "grey": ("no chroma in header and payload", some_file(12, (20, 16), 4, 0.1, grey=True)),
    "upright": ("no shear in the payload", some_file(16, (17, 23), 5, 0.1, upright=True, is_short=True)),
    "needles": ("the finest steps, long numbers, extreme shapes", file_of(needles(10, (40, 32)), (40, 32), 0.0)),
    "texture": (
        "two columns of patches, so that strengths change across the picture",
        some_file(8, (72, 20), 6, 0.1, more=with_texture),
    ),
    "alpha": (
        "a fourth sample, from a payload of its own",
        some_file(14, (26, 20), 7, 0.1, is_short=True, more=with_alpha),
    ),
    "dots": ("classes below 0, and models that see some hundred symbols", file_of(dots(), (40, 36), 0.4, grey=True)),
    "limits": ("integers and Gaussians at every limit; not to be drawn", file_of(at_limits(), (20, 14), 0.0)),
    "far": (
        "more columns than a cell's number holds, more raw bits than a distance takes; not to be drawn",
        file_of(far_apart(), FAR, 0.2, is_short=True),
    ),
    "patches": (
        "two rows and two columns of texture's patches",
        some_file(0, (68, 66), 9, 0.1, is_short=True, more=with_texture),
    ),
    "long alpha": (
        "alpha with a finer quantum than the picture's, in a file that is not short",
        some_file(9, (18, 14), 10, 0.3, more=lambda s: with_alpha(s, 0.017)),
    ),
}
UNDRAWN = {"limits", "far"}
VIEWS: dict[str, list[tuple[float, tuple[int, int, int, int]]]] = {
    "long": [(0.5, (0, 0, 32, 24)), (1.7, (5, 3, 11, 9)), (0.5, (3, 2, 9, 7))],
    "texture": [(0.4, (0, 0, 72, 20)), (2.0, (30, 1, 9, 7))],
}


def vector(name: str) -> dict[str, Any]:
    """Every stage of a file."""
    shows, data = FILES[name]
    file = plain.read(data)
    found: dict[str, Any] = {"name": name, "shows": shows, "bytes": data.hex(), "header": header_of(file)}
    if file.codes:
        found["texture"] = file.codes
    found |= layer(file.header, file.payload, file.integers())
    if file.alpha is not None:
        found["alpha"] = {**fields(file.alpha[0]), **layer(*file.alpha, file.alpha_integers())}
    if name not in UNDRAWN:
        found["pixels"] = picture(decode(data))
    if name in VIEWS:
        found["views"] = [view(data, scale, region) for scale, region in VIEWS[name]]
    return found


def view(data: bytes, scale: float, region: tuple[int, int, int, int]) -> dict[str, Any]:
    """A view, its Gaussians and its pixels."""
    shown = View(scale, region)
    arrays = shown.apply(parse(data).scene()).gaussians.arrays
    gaussians = numbers(np.concatenate(arrays, axis=1).tolist())
    return {"scale": scale, "region": region, "gaussians": gaussians, "pixels": picture(decode(data, view=shown))}


def numbers(gaussians: list[list[float]]) -> list[list[float]]:
    """Gaussians in the order of the file's head."""
    return [[*gaussian, level_of(*gaussian[2:5])] for gaussian in gaussians]


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
    return {
        "payload": payload.hex(),
        "integers": [
            [one.of_class.k, *plain.deinterleave(one.cell), *one.colour, *one.shape, *one.parts, *one.place]
            for one in integers
        ],
        "gaussians": numbers([[*g[:5], *g[5]] for g in (plain.gaussian_of(header, one) for one in integers)]),
    }


def picture(pixels: NDArray[np.uint8]) -> list[str]:
    """The rows of a picture."""
    return [row.tobytes().hex() for row in pixels]


def parts_of(data: bytes) -> dict[str, Any]:
    """How many Gaussians parts of a file's payload hold: of a few bytes, of all but the last, and of all."""
    file = plain.read(data)
    whole = len(file.payload)
    bytes_read = [*range(0, 14, 2), *(whole * part // 8 for part in range(1, 8)), whole - 2, whole - 1, whole]
    return {"bytes": data.hex(), "parts": [[k, len(file.part(k))] for k in sorted({*bytes_read})]}


def text() -> str:
    """All vectors as JSON, a list of plain values in a line."""
    many = replace(MANY.stream, payload=MANY.payload.ljust(MANY.count // 8, b"\0"))
    early, enough = refused_early()
    partly = [*(FILES[name][1] for name in ("short", "long", "grey")), serialise(many)]
    vectors: dict[str, Any] = {
        "version": 2,
        "order": ORDER,
        "files": [vector(name) for name in FILES],
        "parts": [
            *(parts_of(data) for data in partly),
            {"bytes": early.hex(), "parts": [[enough - 2, 0], [enough, None]]},
        ],
        "refuse": [{"reason": reason, "bytes": data.hex()} for reason, data in refused().items()],
    }
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
