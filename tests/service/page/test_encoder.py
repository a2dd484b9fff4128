"""The encoder in JavaScript, in Node, against sgmethod.preview()."""

from __future__ import annotations

import base64
import io
import json
import shutil
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import sgmethod
from benchmarks.harness.data import JAVASCRIPT, PHOTOGRAPHS
from benchmarks.harness.processes import run
from sgmethod.bitstream.text import from_text
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels

ENCODE = """
const { encodePreview } = await import("%s");
const pictures = JSON.parse((await import("node:fs")).readFileSync("pictures.json"));
console.log(JSON.stringify(pictures.map(([data, width, height, options]) => {
  try {
    const { bytes, ...made } = encodePreview(new Uint8Array(Buffer.from(data, "base64")), width, height, options);
    return { ...made, file: Buffer.from(bytes).toString("base64") };
  } catch (error) {
    return `${error.name}: ${error.message}`;
  }
})));
"""


URIS = """
const { dataUri } = await import("%s");
const pictures = JSON.parse((await import("node:fs")).readFileSync("pictures.json"));
const webp = ({ quality }) => ({ toBuffer: async () => new Uint8Array(4 * quality) });
const resize = (width, height) => {
  const toBuffer = async () => new Uint8Array(3 * width * height);
  const image = { removeAlpha: () => image, raw: () => image, toBuffer };
  return image;
};
console.log(JSON.stringify(await Promise.all(pictures.map(async ([data, width, height, { isSharp, ...options }]) => {
  const sharp = isSharp && (() => ({ webp, resize }));
  const rgba = new Uint8Array(Buffer.from(data, "base64"));
  return dataUri(rgba, width, height, { ...options, sharp }).catch((error) => `${error.name}: ${error.message}`);
}))));
"""


def encoded(folder: Path, *calls: tuple[Pixels, Any], script: str = ENCODE, module: str = "encoder.js") -> list[Any]:
    """What encodePreview() makes of pictures [H, W, 4], each with its options; or what it throws."""
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: sudo apt install nodejs")
    given = [(base64.b64encode(p.tobytes()).decode(), p.shape[1], p.shape[0], options) for p, options in calls]
    (folder / "pictures.json").write_text(json.dumps(given))
    script = script.replace("%s", (JAVASCRIPT / "encoder" / module).as_uri())
    done = run("node", "--input-type=module", "--eval", script, folder=folder)
    assert done.status == 0, done.stderr
    found: list[Any] = json.loads(done.stdout)
    return found


def opaque(pixels: Pixels) -> Pixels:
    return np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])


def shown(text: str, size: tuple[int, int]) -> Pixels:
    """The preview at the size of its photograph."""
    file = sgmethod.open(from_text(text))
    return np.asarray(Image.fromarray(file.pixels()).resize(size, Image.Resampling.BICUBIC), np.uint8)


def test_photographs_are_about_as_good_as_from_python(tmp_path: Path) -> None:
    """At most 0.4 dB below in the mean, and 1 dB for one of them; 0.15 and 0.5 were seen."""
    photographs = [np.asarray(Image.open(path).convert("RGB")) for path in sorted(PHOTOGRAPHS.glob("*.png"))]
    calls = [(pixels, most) for pixels in photographs for most in (64, 200)]
    given = [(opaque(pixels), {"bytes": most}) for pixels, most in calls]
    behind = []
    for (pixels, most), made in zip(calls, encoded(tmp_path, *given), strict=True):
        expected, size = sgmethod.preview(pixels, most), (pixels.shape[1], pixels.shape[0])
        assert 0.8 * most <= len(from_text(made["text"])) <= most
        assert base64.b64decode(made["file"]) == from_text(made["text"])
        assert [made[name] for name in ("width", "height", "dark")] == [*size, expected.dark]
        levels = (np.array(list(bytes.fromhex(one[1:])), int) for one in (made["color"], expected.color))
        assert np.abs(np.subtract(*levels)).max() <= 1
        assert sgmethod.info(from_text(made["text"])).width == sgmethod.info(expected.data).width
        behind.append(psnr(shown(expected.text, size), pixels) - psnr(shown(made["text"], size), pixels))
    assert max(behind) <= 1
    assert statistics.fmean(behind) <= 0.4


def test_transparency_grey_and_small_pictures(tmp_path: Path) -> None:
    y, x = np.mgrid[:60, :90]
    round_logo = np.dstack([np.full((60, 90, 3), (200, 30, 60)), 255 * (np.hypot(x - 45, y - 30) < 25)]).astype(
        np.uint8
    )
    slope = opaque(np.repeat((2 * x + y)[..., None], 3, axis=2).astype(np.uint8))
    plain, one = np.full((40, 30, 4), (9, 99, 200, 255), np.uint8), np.full((1, 1, 4), 255, np.uint8)
    strip = opaque(np.repeat((x[:1] * 2)[..., None], 3, axis=2).astype(np.uint8))
    made = encoded(tmp_path, *((picture, {}) for picture in (round_logo, slope, plain, one, strip)))
    logo, grey, *others = (sgmethod.open(from_text(one["text"])) for one in made)
    alpha = logo.pixels()[..., 3]
    assert made[0]["color"] == "#c81e3c"
    assert alpha[0, 0] < 40
    assert alpha[alpha.shape[0] // 2, alpha.shape[1] // 2] > 215
    assert grey.info.to_dict()["grey"]
    assert psnr(grey.pixels()[..., :3], slope[..., :3]) > 30
    assert [one.size for one in others] == [(30, 40), (1, 1), (90, 1)]
    assert np.abs(others[0].pixels().astype(int) - plain[..., :3]).max() <= 8


def test_what_it_refuses(tmp_path: Path) -> None:
    pixel = np.zeros((1, 1, 4), np.uint8)
    wrong = [{"byte": 200}, {"bytes": 15}, {"bytes": 1025}, {"bytes": "200"}]
    answers = encoded(tmp_path, *((pixel, options) for options in wrong), (pixel[..., :3], {}))
    assert [answer.split(":")[0] for answer in answers] == ["TypeError", *["RangeError"] * 3, "TypeError"]
    assert "byte, only bytes" in answers[0]


def test_data_uris(tmp_path: Path) -> None:
    """A PNG of the photograph that fits, and the largest of a stand-in for sharp."""
    photographs = [np.asarray(Image.open(path).convert("RGB")) for path in sorted(PHOTOGRAPHS.glob("*.png"))]
    calls = [(opaque(pixels), {"characters": most}) for pixels in photographs for most in (300, 400)]
    clear, plain = np.zeros((8, 8, 4), np.uint8), np.full((1, 3, 4), 255, np.uint8)
    others = [
        (calls[0][0], {"characters": 90}),
        (clear, {}),
        (plain, {}),
        (calls[0][0], {"isSharp": True}),
        (plain, {"c": 1}),
    ]
    answers = encoded(tmp_path, *calls, *others, script=URIS, module="uri.js")
    qualities = []
    for (pixels, options), uri in zip(calls, answers, strict=False):
        assert 0.8 * options["characters"] < len(uri) <= options["characters"]
        picture = Image.open(io.BytesIO(base64.b64decode(uri.removeprefix("data:image/png;base64,"))))
        assert max(picture.size) <= 32
        drawn = picture.convert("RGB").resize(pixels.shape[1::-1], Image.Resampling.BICUBIC)
        qualities.append(psnr(np.asarray(drawn, np.uint8), pixels[..., :3]))
    assert min(qualities) > 18  # seen: 18.4
    assert all(small < large for small, large in zip(qualities[::2], qualities[1::2], strict=True))
    few, transparent, white, webp, refused = answers[len(calls) :]
    assert (few, transparent) == ("", "")
    assert np.all(np.asarray(Image.open(io.BytesIO(base64.b64decode(white.split(",")[1]))).convert("RGB")) == 255)
    assert len(base64.b64decode(webp.removeprefix("data:image/webp;base64,"))) == 280  # of 400 characters
    assert refused == "TypeError: dataUri() has no option c, only characters and sharp"
