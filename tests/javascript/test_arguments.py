"""What the functions of the npm package take for pictures, bytes, texts and options, and what they refuse."""

from __future__ import annotations

import base64

import pytest

from sgmethod.bitstream.text import to_text
from tests.support.data import golden
from tests.support.node import answer_of

SCRIPT = """
const [{ encodePreview }, { dataUri }, { decodePreview }, { decode, info }] = await Promise.all(
  ["encoder/encoder", "encoder/uri", "preview", "decoder"].map((name) => import(`${src}/${name}.js`)));
const vm = await import("node:vm");
const { text } = given;
const file = Uint8Array.from(Buffer.from(given.file, "base64"));
const outcome = async (call) => {
  try {
    return JSON.stringify(await call());
  } catch (error) {
    return `${error.name}: ${error.message}`;
  }
};
const rgba = Uint8Array.from({ length: 4 * 3 * 2 }, (_, i) => 10 * i);
const other = vm.runInNewContext("Uint8Array").from(rgba); // of another window
console.log(JSON.stringify(await Promise.all([%s].map(outcome))));
"""
KIND = "must be a Uint8Array, a Uint8ClampedArray or an ArrayBuffer, not"
AS_SRGB = 'give getImageData() { colorSpace: "srgb" }'


def outcomes(*calls: str) -> list[str]:
    """What expressions in JavaScript return, as JSON, or throw."""
    data = golden(2)["v2-color"]
    given = {"text": to_text(data), "file": base64.b64encode(data).decode()}
    found: list[str] = answer_of(SCRIPT % ", ".join(f"() => {call}" for call in calls), given)
    return found


def test_bytes_of_any_kind_are_taken() -> None:
    pictures = ["rgba", "new Uint8ClampedArray(rgba)", "rgba.buffer", "Buffer.from(rgba)", "other", "{ data: rgba }"]
    pictures.append("{ data: rgba, colorSpace: 'srgb' }")
    encoded = outcomes(*(f"encodePreview({one}, 3, 2, {{ bytes: 40 }}).text" for one in pictures))
    files = ["file", "new Uint8ClampedArray(file)", "file.buffer", "Buffer.from(file)"]
    decoded = outcomes(*(f"[decode({one}, {{ width: 8 }}).data, info({one})]" for one in files))
    assert len(set(encoded)) == len(set(decoded)) == 1
    assert "Error" not in encoded[0] + decoded[0]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("new Float32Array(24).fill(0.5), 3, 2", f"rgba {KIND} Float32Array"),
        ("new Uint16Array(24), 3, 2", f"rgba {KIND} Uint16Array"),
        ("Array(24).fill(NaN), 3, 2", f"rgba {KIND} Array"),
        ("'x'.repeat(24), 3, 2", f"rgba {KIND} String"),
        ("null, 3, 2", f"rgba {KIND} Null"),
        ("{ data: new Float32Array(24) }, 3, 2", f"rgba {KIND} Float32Array"),
        ("{ data: rgba, colorSpace: 'display-p3' }, 3, 2", f"rgba must be in sRGB, not display-p3: {AS_SRGB}"),
        ("rgba.subarray(4), 3, 2", "rgba of 3 x 2 pixels must have 24 bytes, 4 a pixel, not 20"),
        ("rgba, 1.5, 4", "width and height must be whole numbers from 1 on, not 1.5 and 4"),
        ("rgba, '3', 2", "width and height must be whole numbers from 1 on, not 3 and 2"),
        ("rgba, 0, 0", "width and height must be whole numbers from 1 on, not 0 and 0"),
        ("rgba, 3, 2, 64", "options must be an object"),
        ("rgba, 3, 2, null", "options must be an object"),
    ],
)
def test_pictures_that_are_refused(given: str, said: str) -> None:
    assert outcomes(f"encodePreview({given})", f"dataUri({given})") == [f"TypeError: {said}"] * 2


def test_texts_and_files_that_are_refused() -> None:
    wrong = ["null", "undefined", "7", "{}", "[text]", "file", "file.buffer", "Symbol('x')", "'*'", "''", "text + '%'"]
    refused = outcomes(*(f"decodePreview({one})" for one in wrong))
    assert refused == ["SgError: the file is damaged: it is no preview"] * len(wrong)
    sizes = outcomes(*(f"decodePreview(text, {size})" for size in ("0", "NaN", "-5", "1e9", "'x'")))
    assert sizes == ["RangeError: size must be 1 to 16384"] * 5
    kinds = {"null": "Null", "7": "Number", "{}": "Object", "text": "String", "[211, 194]": "Array"}
    for function in ("decode", "info"):
        found = outcomes(*(f"{function}({one})" for one in kinds))
        assert found == [f"TypeError: bytes {KIND} {kind}" for kind in kinds.values()]
    assert outcomes("decode(file, 2)", "decode(file, null)") == ["TypeError: options must be an object"] * 2
    wrong = outcomes("decode(file, { widht: 24 })", "decode(file, { scale: 2, width: 24 })")
    assert [one.partition(":")[0] for one in wrong] == ["TypeError"] * 2
    assert outcomes("decode(file, { region: 5 })") == ["TypeError: region must be [x, y, width, height]"]
