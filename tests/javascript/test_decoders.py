"""The decoders of previews and of files, in Node, against ours."""

from __future__ import annotations

import base64

import numpy as np

import sgmethod
from sgmethod.bitstream import v2
from sgmethod.bitstream.text import to_text
from tests.support.data import golden
from tests.support.node import answer_of, assert_as_python

SIZE = 96  # of the longer side, pixels
SHORT = [golden(2)[name] for name in ("v2-color", "v2-grey", "v2-empty")]
GOOD = to_text(SHORT[0])
TEXTURED, LONG = to_text(golden(2)["v2-short-alpha"]), to_text(golden(2)["v2-long"])
STRAY_BITS = GOOD[:-1] + chr(ord(GOOD[-1]) + 1)
BAD = ["", "x", "no preview", GOOD[:-4], GOOD[:200] + "A" + GOOD[201:], TEXTURED, LONG, "A" + GOOD[1:]]
BAD += [GOOD + "=", GOOD + "\n", STRAY_BITS]
DECODE = """
const { decodePreview } = await import(`${src}/preview.js`);
console.log(JSON.stringify(given.texts.map((text) => {
  try {
    const { width, height, data } = decodePreview(text, given.size);
    return [width, height, btoa(String.fromCharCode(...data))];
  } catch (error) {
    return String(error.message);
  }
})));
"""


def test_the_small_decoder() -> None:
    """The files as Python draws them, within what docs/format.md allows two decoders; and what is bad refused."""
    see_through = np.zeros((12, 16, 4), np.uint8)
    see_through[:, 8:] = (200, 90, 20, 255)
    files = [*SHORT, sgmethod.encode(see_through, bytes=60, tune="psnr", effort=1).data]
    found = answer_of(DECODE, {"texts": [*map(to_text, files), *BAD], "size": SIZE})
    drawn, refused = found[: len(files)], found[len(files) :]
    for (width, height, levels), data in zip(drawn, files, strict=True):
        ours = np.frombuffer(base64.b64decode(levels), np.uint8).reshape(height, width, 4).astype(int)
        info = sgmethod.info(data)
        assert_as_python(ours, data, scale=SIZE / max(info.width, info.height))
    assert [type(answer) for answer in refused] == [str] * len(BAD)


VIEWS = [
    {"width": 24},
    {"height": 10},
    {"width": 24, "height": 10},
    {"width": 9, "region": [4, 4, 18, 6]},
    {"scale": 2},
]
MEASURE = """
const { decode, info } = await import(`${src}/decoder.js`);
const bytes = Uint8Array.from(Buffer.from(given.file, "base64"));
const pictures = given.views.map((view) => decode(bytes, view));
console.log(JSON.stringify([pictures.map(({ width, height }) => [width, height]), info(bytes)]));
"""


HEADERS = "const it = await import(`${src}/header.js`); console.log(JSON.stringify([it.HEADER, it.ALPHA_HEADER]));"


def test_headers_have_the_fields_of_python() -> None:
    ours = [[[one.bits, one.short_bits, one.grows] for one in header] for header in (v2.HEADER, v2.ALPHA_HEADER)]
    assert answer_of(HEADERS) == ours


def test_the_whole_decoder() -> None:
    """Sizes as Python's, and what a file holds; tests/bitstream has its pixels."""
    data = golden(2)["v2-short-alpha"]
    sizes, found = answer_of(MEASURE, {"file": base64.b64encode(data).decode(), "views": VIEWS})
    file = sgmethod.open(data)
    expected = [file.pixels(**view).shape[1::-1] for view in VIEWS]  # type: ignore[arg-type]
    assert sizes == [list(size) for size in expected]
    of_python = {name: getattr(file.info, name) for name in ("width", "height", "gaussians", "alpha", "texture")}
    assert found == of_python
