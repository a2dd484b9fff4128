"""docs/format/vectors.json: what each decoder makes of the files in it, stage by stage."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from sgmethod import BitstreamError, View, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from tests.bitstream import plain_decoder_v2
from tests.bitstream.document import rows
from tests.bitstream.remake import maps_of, refusals, row_of
from tests.support.data import ROOT
from tests.support.node import answer_of

VECTORS = json.loads((ROOT / "docs" / "format" / "vectors.json").read_text())
FILES = {one["name"]: one for one in VECTORS["files"]}
NAMES = pytest.mark.parametrize("name", FILES)


@NAMES
def test_the_plain_decoder_finds_the_same(name: str) -> None:
    drawing = pytest.importorskip("tests.definitions.drawing", reason="the definition of levels needs PyTorch")
    file, of = plain_decoder_v2.read(bytes.fromhex(FILES[name]["bytes"])), FILES[name]
    h = file.header
    flags = h.grey, h.upright, bool(file.codes), file.alpha is not None, h.is_short
    fields = *flags, h.width, h.height, h.quantum, list(h.background)
    assert of["header"] == dict(zip(of["header"], fields, strict=True))
    assert of.get("texture", []) == file.codes
    layers = [(of, h, file.payload, file.integers())]
    if file.alpha is not None:
        layers.append((of["alpha"], *file.alpha, file.alpha_integers()))
    for layer, header, payload, integers in layers:
        assert layer["payload"] == payload.hex()
        assert layer["integers"] == [row_of(one) for one in integers]
        assert layer.get("map", []) == (maps_of(integers) if "map" in layer else [])
        gaussians = [plain_decoder_v2.gaussian_of(header, one) for one in integers]
        assert layer["gaussians"] == [[*g[:5], *g[5], drawing.level_of(*g[2:5])] for g in gaussians]


def stream_of(name: str) -> StreamV2:
    stream = container.parse(bytes.fromhex(FILES[name]["bytes"]))
    assert isinstance(stream, StreamV2)
    return stream


def assert_layer(stream: StreamV2, layer: dict[str, Any]) -> None:
    assert stream.payload.hex() == layer["payload"]
    found = np.concatenate(stream.gaussians().arrays, axis=1)
    assert found.tolist() == [row[:8] for row in layer["gaussians"]]
    assert len(layer["integers"]) == len(found)


@NAMES
def test_our_decoder_finds_the_same(name: str) -> None:
    stream, of = stream_of(name), FILES[name]
    assert of["header"] == {
        "grey": stream.grey,
        "upright": stream.upright,
        "texture": stream.texture is not None,
        "alpha": stream.alpha is not None,
        "short": stream.is_short,
        "width": stream.width,
        "height": stream.height,
        "quantum": stream.quantum,
        "background": list(stream.background),
    }
    assert of.get("texture") == (None if stream.texture is None else stream.texture.tolist())
    assert_layer(stream, of)
    if stream.alpha is not None:
        fields = of["alpha"]["quantum"], tuple(of["alpha"]["background"])
        assert fields == (stream.alpha.quantum, stream.alpha.background)
        assert_layer(stream.alpha, of["alpha"])


def pixels_of(rows: list[str], channels: int) -> np.ndarray:
    return np.frombuffer(bytes.fromhex("".join(rows)), np.uint8).reshape(len(rows), -1, channels)


@pytest.mark.parametrize("of", VECTORS["parts"])
def test_parts_hold_the_first_gaussians_of_the_whole(of: dict[str, Any]) -> None:
    data = bytes.fromhex(of["bytes"])
    stream, plain = container.parse(data), plain_decoder_v2.read(data)
    assert isinstance(stream, StreamV2)
    whole = len(stream.payload)
    is_refused = of["parts"][-1][1] is None
    gaussians = [] if is_refused else plain.gaussians()
    for k, n in of["parts"]:
        prefix = max(k - 0.5, 0) / whole if k < whole else 1
        if n is None:
            with pytest.raises(BitstreamError):
                stream.gaussians(prefix)
            with pytest.raises(plain_decoder_v2.RefusedError):
                plain.part(k)
        else:
            assert rows(stream.gaussians(prefix)) == plain.part(k) == gaussians[:n]


def test_files_to_refuse_are_as_they_are_made() -> None:
    assert {of["reason"]: of["bytes"] for of in VECTORS["refuse"]} == {
        reason: data.hex() for reason, data in refusals().items()
    }


@pytest.mark.parametrize("of", VECTORS["refuse"], ids=lambda of: of["reason"])
def test_our_decoder_and_the_plain_one_refuse(of: dict[str, Any]) -> None:
    data = bytes.fromhex(of["bytes"])
    with pytest.raises(BitstreamError):
        decode(data)
    with pytest.raises(plain_decoder_v2.RefusedError):
        file = plain_decoder_v2.read(data)
        file.gaussians(), file.alpha_gaussians()


@pytest.mark.parametrize("name", [name for name, of in FILES.items() if "pixels" in of])
def test_our_decoder_draws_the_same(name: str) -> None:
    """A decoder of plain Python once drew these pixels, from docs/format.md alone."""
    of = FILES[name]
    data, channels = bytes.fromhex(of["bytes"]), 4 if of["header"]["alpha"] else 3
    assert np.array_equal(decode(data), pixels_of(of["pixels"], channels))
    for view in of.get("views", []):
        drawn = decode(data, view=View(view["scale"], tuple(view["region"])))
        assert np.array_equal(drawn, pixels_of(view["pixels"], channels))


SCRIPT = """
const { SgError, decode } = await import(`${src}/decoder.js`);
const { countInPart, readFile } = await import(`${src}/file.js`);
const bytesOf = (hex) => Uint8Array.from(hex.match(/../g), (byte) => parseInt(byte, 16));
const files = given.files.map(([hex, views]) => {
  const bytes = bytesOf(hex);
  const { width, height, quantum, background, values, alpha } = readFile(bytes);
  const pixels = views.map((view) => Buffer.from(decode(bytes, view).data).toString("hex"));
  const header = { width, height, quantum, background };
  return { header, values: [...values], alpha: [...(alpha?.values ?? [])], pixels };
});
const parts = given.parts.map((of) => {
  const file = readFile(bytesOf(of.bytes));
  return of.parts.map(([k]) => [k, countInPart(file, Math.max(k - 0.5, 0) / file.payloadBytes)]);
});
const accepted = given.refuse.filter((of) => {
  try {
    decode(bytesOf(of.bytes));
    return true;
  } catch (error) {
    return !(error instanceof SgError);
  }
});
console.log(JSON.stringify({ files, parts, accepted }));
"""


def drawn(of: dict[str, Any]) -> list[dict[str, Any]]:
    """The picture, if it is to be drawn, and the views of a file."""
    return [*([of] if "pixels" in of else []), *of.get("views", [])]


def test_the_decoder_in_javascript_does_the_same() -> None:
    asked = [
        [of["bytes"], [{key: one[key] for key in one.keys() & {"scale", "region"}} for one in drawn(of)]]
        for of in FILES.values()
    ]
    parted = [of for of in VECTORS["parts"] if all(n is not None for _, n in of["parts"])]
    answers = answer_of(SCRIPT, {"files": asked, "parts": parted, "refuse": VECTORS["refuse"]})
    assert answers["accepted"] == []
    assert answers["parts"] == [of["parts"] for of in parted]
    for answer, of in zip(answers["files"], FILES.values(), strict=True):
        assert_same_answer(answer, of)


def assert_same_answer(answer: dict[str, Any], of: dict[str, Any]) -> None:
    """What the decoder in JavaScript makes of a file, against the vector."""
    assert answer["header"].items() <= of["header"].items()
    for found, layer in ((answer["values"], of), (answer["alpha"], of.get("alpha", {"gaussians": []}))):
        assert found == [value for row in layer["gaussians"] for value in row[:8]]
    channels = 4 if of["header"]["alpha"] else 3
    for hexadecimal, wanted in zip(answer["pixels"], drawn(of), strict=True):
        pixels = np.frombuffer(bytes.fromhex(hexadecimal), np.uint8).reshape(len(wanted["pixels"]), -1, 4)
        assert np.array_equal(pixels[..., :channels], pixels_of(wanted["pixels"], channels))
        assert channels == 4 or (pixels[..., 3] == 255).all()
