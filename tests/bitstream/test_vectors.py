"""docs/format/vectors.json: what the command writes, and what our decoders make of the files in it, stage by stage."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from sgmethod import View, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from tests.bitstream import make_vectors
from tests.harness.data import JAVASCRIPT

MOST_BYTES = 300_000
TEXT = make_vectors.VECTORS.read_text()
FILES = {one["name"]: one for one in json.loads(TEXT)["files"]}
NAMES = pytest.mark.parametrize("name", FILES)


def test_the_file_is_what_the_command_writes() -> None:
    assert make_vectors.text() == TEXT
    assert len(TEXT) < MOST_BYTES


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
        said = of["alpha"]["quantum"], tuple(of["alpha"]["background"])
        assert said == (stream.alpha.quantum, stream.alpha.background)
        assert_layer(stream.alpha, of["alpha"])


def pixels_of(rows: list[str], channels: int) -> np.ndarray:
    return np.frombuffer(bytes.fromhex("".join(rows)), np.uint8).reshape(len(rows), -1, channels)


@NAMES
def test_our_decoder_draws_the_same(name: str) -> None:
    """No sample differs, though it might."""
    of = FILES[name]
    data, channels = bytes.fromhex(of["bytes"]), 4 if of["header"]["alpha"] else 3
    assert np.array_equal(decode(data), pixels_of(of["pixels"], channels))
    for view in of.get("views", []):
        drawn = decode(data, view=View(view["scale"], tuple(view["region"])))
        assert np.array_equal(drawn, pixels_of(view["pixels"], channels))


SCRIPT = """
const {{ decode }} = await import("{folder}/decoder.js");
const {{ readFile }} = await import("{folder}/file.js");
const answers = {files}.map(([hex, views]) => {{
  const bytes = Uint8Array.from(hex.match(/../g), (byte) => parseInt(byte, 16));
  const {{ width, height, quantum, background, values, alpha }} = readFile(bytes);
  const pixels = views.map((view) => Buffer.from(decode(bytes, view).data).toString("hex"));
  const header = {{ width, height, quantum, background }};
  return {{ header, values: [...values], alpha: [...(alpha?.values ?? [])], pixels }};
}});
console.log(JSON.stringify(answers));
"""


def test_the_decoder_in_javascript_does_the_same() -> None:
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: sudo apt install nodejs")
    asked = [[of["bytes"], [{}, *of.get("views", [])]] for of in FILES.values()]
    script = SCRIPT.format(folder=JAVASCRIPT.as_uri(), files=json.dumps(asked))
    command = ["node", "--input-type=module", "--no-warnings", "--eval", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    for answer, of in zip(json.loads(done.stdout), FILES.values(), strict=True):
        assert answer["header"].items() <= of["header"].items()
        for found, layer in ((answer["values"], of), (answer["alpha"], of.get("alpha", {"gaussians": []}))):
            assert found == [value for row in layer["gaussians"] for value in row[:8]]
        channels = 4 if of["header"]["alpha"] else 3
        for hexadecimal, wanted in zip(answer["pixels"], [of, *of.get("views", [])], strict=True):
            pixels = np.frombuffer(bytes.fromhex(hexadecimal), np.uint8).reshape(len(wanted["pixels"]), -1, 4)
            assert np.array_equal(pixels[..., :channels], pixels_of(wanted["pixels"], channels))
            assert channels == 4 or (pixels[..., 3] == 255).all()
