"""sgmethod/node of the npm package: photographs, its cache, what it refuses, and recipes that rest on it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import from_text
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels
from tests.io.profiles import DISPLAY_P3, rgb
from tests.javascript.site import SHOWN, answers, served
from tests.support.browser import Page
from tests.support.data import PHOTOGRAPHS, code_in
from tests.support.node import answer_of, node, packed
from tests.support.pictures import saved
from tests.support.processes import TIMEOUT_S, free_port, wait_until

pytestmark = pytest.mark.thorough

PARROT = PHOTOGRAPHS / "kodim23-crop.png"
PREVIEWS = """
import { elementOf, previewOf } from "sgmethod/node";
const answers = await Promise.all(given.map(([photograph, options]) =>
  previewOf(photograph, options).catch((error) => `${error.name}: ${error.message}`)));
console.log(JSON.stringify(answers));
"""


def previews(folder: Path, *tasks: tuple[object, dict[str, Any]]) -> list[Any]:
    """What previewOf() answers: a preview, or the words of an error."""
    found: list[Any] = answer_of(PREVIEWS, tasks, folder)
    return found


def photographs(folder: Path) -> dict[str, Path]:
    """Photographs that are easily read wrong."""
    parrot = Image.open(PARROT).convert("RGB")
    rotated = Image.Exif()
    rotated[0x112] = 6  # a quarter turn
    made: dict[str, tuple[Image.Image, dict[str, Any]]] = {
        "rotated.jpg": (parrot, {"exif": rotated, "quality": 95}),
        "p3.jpg": (parrot, {"icc_profile": rgb(DISPLAY_P3), "quality": 95}),
        "grey.png": (parrot.convert("L"), {}),
        "animated.webp": (parrot, {"save_all": True, "append_images": [Image.new("RGB", parrot.size, "blue")] * 2}),
        "large.jpg": (parrot.resize((8660, 5774)), {"quality": 80}),  # 50 megapixels
    }
    see_through = parrot.convert("RGBA")
    see_through.paste((0, 0, 0, 0), (0, 0, 60, 96))
    made["transparent.png"] = (see_through, {})
    for name, (picture, how) in made.items():
        picture.save(folder / name, **how)
    return {name: folder / name for name in made}


def faulty() -> dict[str, bytes]:
    """Files with faults that browsers overlook, and files that are cut."""
    picture = Image.open(PARROT).convert("RGB")
    jpeg = saved(picture, "JPEG")
    tables, parameters, samples = jpeg.index(b"\xff\xdb"), jpeg.index(b"\xff\xda") + 11, len(jpeg) // 2
    kinds = {kind: saved(picture, kind) for kind in ("JPEG", "PNG", "WEBP", "GIF", "TIFF", "AVIF")}
    kinds["progressive JPEG"] = saved(picture, "JPEG", progressive=True)
    return {
        "parameters of a scan that are 0": jpeg[:parameters] + bytes(3) + jpeg[parameters + 3 :],
        "bytes between two markers": jpeg[:tables] + bytes(18) + jpeg[tables:],
        "a version of JFIF that is unknown": jpeg.replace(b"JFIF\0\1", b"JFIF\0\7", 1),
        "samples that are damaged": jpeg[:samples] + bytes(60) + jpeg[samples + 60 :],
        "an end before the last samples": jpeg[:samples] + b"\xff\xd9" + jpeg[samples + 2 :],
        "EXIF that is cut short": jpeg[:2] + b"\xff\xe1\0\x0cExif\0\0II*\0" + jpeg[2:],
        "a profile that is none": saved(picture, icc_profile=b"no profile"),
        **{f"{kind} with bytes after its end": data + bytes(9) for kind, data in kinds.items()},
        **{f"cut in the middle, {kind}": data[: len(data) // 2] for kind, data in kinds.items()},
        **{f"cut at its end, {kind}": data[:-2] for kind, data in kinds.items() if "JPEG" in kind},
    }


def assert_as_coloured(made: dict[str, Any], data: bytes) -> None:
    ours = sgmethod.preview(data)
    colours = zip(bytes.fromhex(made["color"][1:]), bytes.fromhex(ours.color[1:]), strict=True)
    assert all(abs(one - other) <= 2 for one, other in colours)


@pytest.mark.filterwarnings("ignore:its colour profile is ignored")
def test_faults_that_browsers_overlook(npm_site: Path) -> None:
    """Photographs of some telephones have them. Python reads and refuses the same files."""
    files = faulty()
    for name, data in files.items():
        (npm_site / name).write_bytes(data)
    found = previews(npm_site, *((name, {}) for name in files))
    for (name, data), made in zip(files.items(), found, strict=True):
        if name.startswith("cut"):
            assert made.startswith(f"SgError: {name} cannot be read: ")
            with pytest.raises(sgmethod.ImageError, match="truncated"):
                sgmethod.preview(data)
        else:
            assert_as_coloured(made, data)


def over_black(pixels: Pixels) -> Pixels:
    return (pixels[..., :3] * (pixels[..., 3:] / 255)).astype(np.uint8) if pixels.shape[2] == 4 else pixels


@pytest.mark.filterwarnings("ignore:only the first of several pictures")
def test_photographs_that_are_easily_read_wrong(npm_site: Path) -> None:
    """Sizes, colours and pictures are those of Python's reader, which has its own tests."""
    files = photographs(npm_site)
    found = previews(npm_site, *((str(path), {"bytes": 400}) for path in files.values()))
    for (name, path), made in zip(files.items(), found, strict=True):
        with_alpha = name == "transparent.png"
        pixels = np.asarray(Image.open(path)) if with_alpha else read_image_8_bit(path.read_bytes())
        assert (made["width"], made["height"]) == pixels.shape[1::-1], name
        assert len(from_text(made["text"])) <= 400
        decoded = sgmethod.decode(from_text(made["text"]))
        assert decoded.shape[2] == pixels.shape[2] == (4 if with_alpha else 3), name
        small = np.asarray(Image.fromarray(pixels).resize(decoded.shape[1::-1], Image.Resampling.BOX))
        assert psnr(over_black(decoded), over_black(small)) > 18, name  # seen: 23.1
        assert bool(made["uri"]) != with_alpha
        assert len(made["uri"]) <= 400
        assert_as_coloured(made, path.read_bytes())


def test_the_cache_holds_previews_by_content_and_options(npm_site: Path) -> None:
    shutil.copy(PARROT, npm_site / "a.png")
    shutil.copy(PARROT, npm_site / "b.png")
    cache = npm_site / "node_modules" / ".cache" / "sgmethod"
    (made,) = previews(npm_site, ("a.png", {}))
    (kept,) = cache.iterdir()
    assert json.loads(kept.read_text()) == made
    kept.write_text('{ "text": "kept" }')
    elsewhere = {"cache": str(npm_site / "other")}
    others = (("a.png", options) for options in ({"bytes": 64}, elsewhere, {"cache": False}))
    found = previews(npm_site, ("b.png", {}), *others)
    assert [one["text"] == "kept" for one in found] == [True, False, False, False]
    assert found[2] == found[3] == made
    assert len(list(cache.iterdir())) == 2
    within = npm_site / "packages" / "site"  # of a workspace, whose modules lie at its root
    within.mkdir(parents=True)
    assert previews(within, ("../../b.png", {}))[0]["text"] == "kept"
    Image.open(PARROT).rotate(180).save(npm_site / "a.png")
    assert previews(npm_site, ("a.png", {}))[0]["text"] not in ("kept", made["text"])
    kept.write_text("{ not whole")
    (npm_site / "file").touch()  # where no folder can be
    assert previews(npm_site, ("b.png", {}), ("b.png", {"cache": str(npm_site / "file")})) == [made, made]


ODD = """
import { readFileSync } from "node:fs";
import { SgError } from "sgmethod";
import { previewOf } from "sgmethod/node";
const photo = readFileSync("a.png");
const buffer = photo.buffer.slice(photo.byteOffset, photo.byteOffset + photo.length);
const other = (await import("node:vm")).runInNewContext("Uint8Array").from(photo); // of another realm
const options = [{ bytes: 8 }, { bytes: new Proxy({}, {}) }, { characters: "400" }, { cache: true },
  { bits: 200 }, null];
const tasks = [[photo], [buffer], [other], [new URL("a.png", `file://${process.cwd()}/`)],
  [new Uint8Array()], [photo.subarray(0, 50)], ["https://example.org/a.png"], [new URL("https://example.org/a.png")],
  [[...photo]], [new Float32Array(3)], [undefined], ["text.jpg"], ["none.jpg"],
  ...options.map((option) => [photo, option])];
const answers = await Promise.all(tasks.map((task) => previewOf(...task).then(
  ({ text }) => text, (error) => [error instanceof SgError, `${error.name}: ${error.message}`])));
console.log(JSON.stringify(answers));
"""


def test_photographs_and_options_of_every_kind(npm_site: Path) -> None:
    """What is no picture is an SgError, what is no photograph a TypeError, and the process ends after each of them."""
    shutil.copy(PARROT, npm_site / "a.png")
    (npm_site / "text.jpg").write_text("no photograph")
    found = answer_of(ODD, folder=npm_site)
    assert len(set(found[:4])) == 1
    assert found[4] == [True, "SgError: the photograph is empty"]
    assert found[5][0] and found[5][1].startswith("SgError: the photograph cannot be read: ")
    kinds = "a path, a file URL, or the bytes of an image file as a Uint8Array or ArrayBuffer"
    assert found[6:11] == [[False, f"TypeError: photograph must be {kinds}"]] * 5
    assert found[11][0] and found[11][1].startswith("SgError: text.jpg cannot be read: ")
    assert found[12] == [False, "Error: ENOENT: no such file or directory, open 'none.jpg'"]
    assert found[13:] == [
        [False, "RangeError: bytes must be a whole number from 16 to 1024"],
        [False, "RangeError: bytes must be a whole number from 16 to 1024"],
        [False, "RangeError: characters must be a number from 0 on"],
        [False, "TypeError: cache must be the path of a folder, or false"],
        [False, "TypeError: previewOf() has no option bits, only bytes, characters and cache"],
        [False, "TypeError: options must be an object"],
    ]


WORKER = """
import { existsSync, writeFileSync } from "node:fs";
import { parentPort } from "node:worker_threads";
parentPort.on("message", () => {
  if (existsSync("failed")) return parentPort.postMessage({ text: "of the next worker" });
  writeFileSync("failed", "");
  FAIL
});
"""
TWICE = """
import { copyFileSync } from "node:fs";
import { previewOf } from "sgmethod/node";
const made = async () => (await previewOf("a.png", { cache: false })).text;
const first = await made();
copyFileSync("worker.js", "node_modules/sgmethod/dist/sgmethod-worker.js");
console.log(JSON.stringify([first, await made()]));
"""
FAILURES = {
    "exits": "process.exit();",
    "throws": 'throw new Error("out of memory");',
    "answers with something else": "parentPort.postMessage(null);",
    "is missing": None,
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_worker_that_fails(npm_site: Path, failure: str) -> None:
    """The preview is made in the calling thread. The next one has another worker, unless there is no file of it."""
    shutil.copy(PARROT, npm_site / "a.png")
    (expected,) = previews(npm_site, ("a.png", {"cache": False}))
    program = npm_site / "node_modules" / "sgmethod" / "dist" / "sgmethod-worker.js"
    program.unlink()
    (npm_site / "worker.js").write_text(WORKER.replace("FAIL", FAILURES[failure] or ""))
    if FAILURES[failure]:
        shutil.copy(npm_site / "worker.js", program)
    again = "of the next worker" if FAILURES[failure] else expected["text"]
    assert answer_of(TWICE, folder=npm_site) == [expected["text"], again]


def test_the_recipe_for_express(npm_site: Path) -> None:
    port = free_port()
    (recipe,) = code_in("docs/previews.md", heading="Express")
    (npm_site / "server.mjs").write_text(recipe.replace("3000", str(port)))
    with subprocess.Popen(["node", "server.mjs"], cwd=npm_site) as server:
        try:
            wait_until(lambda: answers(port))
            photo, text, nothing = (
                httpx2.post(f"http://127.0.0.1:{port}/photos", content=data, timeout=TIMEOUT_S)
                for data in (PARROT.read_bytes(), b"text", b"")
            )
        finally:
            server.terminate()
    assert (photo.status_code, photo.json()["width"], photo.json()["height"]) == (200, 128, 96)
    assert len(from_text(photo.json()["text"])) <= 200
    assert (text.status_code, text.json()["detail"][:30]) == (422, "the photograph cannot be read:")
    assert (nothing.status_code, nothing.json()["detail"]) == (422, "the photograph is empty")
    assert not (npm_site / "node_modules" / ".cache").exists()


def test_sharp_that_is_missing_or_cannot_be_loaded_is_named(tmp_path: Path) -> None:
    modules = tmp_path / "node_modules"
    modules.mkdir()
    shutil.unpack_archive(packed(), modules)
    (modules / "package").rename(modules / "sgmethod")
    shutil.copy(PARROT, tmp_path / "a.png")
    needed = "Error: previews need sharp 0.34 or later, which reads image files: npm install sharp"
    assert previews(tmp_path, ("a.png", {}))[0].startswith(f"{needed} (Cannot find package 'sharp'")
    (modules / "sharp").mkdir()  # an old one
    (modules / "sharp" / "package.json").write_text('{ "type": "module", "exports": "./index.js" }')
    (modules / "sharp" / "index.js").write_text("export default () => ({});")
    assert previews(tmp_path, ("a.png", {})) == [needed]
    (modules / "sharp" / "index.js").write_text("throw new Error('no sharp-linux-x64.node');")  # of another system
    assert previews(tmp_path, ("a.png", {})) == [f"{needed} (no sharp-linux-x64.node)"]


ELEVENTY = """
const { default: configure } = await import("./eleventy.config.mjs");
const addShortcode = async (name, made) => console.log(await made("photos/door.png", 'A "red" door'));
configure({ addPassthroughCopy() {}, addShortcode });
"""


def test_eleventy(npm_site: Path) -> None:
    (npm_site / "eleventy.config.mjs").write_text(code_in("docs/previews.md", heading="Eleventy")[0])
    (npm_site / "photos").mkdir()
    shutil.copy(PARROT, npm_site / "photos" / "door.png")
    printed = node(ELEVENTY, folder=npm_site)
    size = 'width="128" height="96" loading="lazy" decoding="async"'
    style = r'style="background-image:url\(data:image/webp;base64,\S+\)"'
    img = rf'<img src="/photos/door.png" alt="A &quot;red&quot; door" {size} {style}>'
    found = re.fullmatch(rf'<sg-img preview="(\S+)">{img}</sg-img>\n', printed)
    assert found
    assert len(from_text(found[1])) <= 200


def test_the_readme_shows_what_its_script_prints(npm_site: Path) -> None:
    (script,), (shown,) = code_in("README.md", "js"), code_in("README.md", "html")
    Image.open(PARROT).resize((768, 512)).save(npm_site / "photo.jpg")
    on_one_line = re.sub(r"\s+", " ", re.sub(r">\s+<", "><", shown)).strip()
    cut = re.sub(r"\w+…", "…", on_one_line)  # the texts of another photograph
    assert re.fullmatch(re.escape(cut).replace("…", r"[\w+/=-]+"), node(script, folder=npm_site).strip())


@pytest.mark.parametrize("document", ["docs/previews.md", "sgmethod/javascript/README.md"])
def test_a_page_in_one_script(each_browser: Page, npm_site: Path, document: str) -> None:
    """The first steps of the documents."""
    (script,) = [code for code in code_in(document) if "writeFileSync(" in code]
    (npm_site / "photos").mkdir()
    for name in ("photo.jpg", "photos/photo.jpg"):
        Image.open(PARROT).save(npm_site / name)
    node(script, folder=npm_site)
    with served(npm_site) as here:
        each_browser.open(here.url)
        wait_until(lambda: [one["loaded"] for one in each_browser.run(SHOWN)] == [128])
        assert each_browser.run("return Boolean(customElements.get('sg-img'))")
