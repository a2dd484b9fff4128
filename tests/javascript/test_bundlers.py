"""sgmethod/node and sgmethod/vite of the npm package: with photographs, in builds, on a development server."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import from_text
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.scene import Pixels
from tests.io.profiles import DISPLAY_P3, rgb
from tests.javascript.site import Site, served
from tests.support.browser import Page
from tests.support.data import PHOTOGRAPHS, ROOT, code_in
from tests.support.node import answer_of, install, node
from tests.support.processes import free_port, run, wait_until

pytestmark = pytest.mark.thorough

PARROT = PHOTOGRAPHS / "kodim23-crop.png"
PREVIEWS = """
import { elementOf, previewOf } from "sgmethod/node";
const answers = await Promise.all(given.map(([photograph, options]) =>
  previewOf(photograph, options).catch((error) => `${error.name}: ${error.message}`)));
console.log(JSON.stringify(answers));
"""


def packed() -> Path:
    """The package as npm installs it."""
    files = sorted((ROOT / "dist").glob("sgmethod-*.tgz"))
    if not files:
        pytest.skip("the npm package is not built: make npm, which needs Node and npm")
    return files[-1]


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder node_modules with Vite, sharp, TypeScript and the package."""
    folder = tmp_path_factory.mktemp("packages")
    install(folder, packed(), "vite@8", "sharp@0.35", "typescript@5")
    return folder / "node_modules"


@pytest.fixture
def site(packages: Path, tmp_path: Path) -> Path:
    """A folder in which they can be imported, with a cache of its own."""
    (tmp_path / "package.json").write_text('{ "private": true, "type": "module" }')
    shutil.copytree(packages, tmp_path / "node_modules", symlinks=True, copy_function=os.link)
    return tmp_path


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


def over_black(pixels: Pixels) -> Pixels:
    return (pixels[..., :3] * (pixels[..., 3:] / 255)).astype(np.uint8) if pixels.shape[2] == 4 else pixels


@pytest.mark.filterwarnings("ignore:only the first of several pictures")
def test_photographs_that_are_easily_read_wrong(site: Path) -> None:
    """Sizes, colours and pictures are those of Python's reader, which has its own tests."""
    files = photographs(site)
    found = previews(site, *((str(path), {"bytes": 400}) for path in files.values()))
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
        ours = sgmethod.preview(path.read_bytes())
        colours = zip(bytes.fromhex(made["color"][1:]), bytes.fromhex(ours.color[1:]), strict=True)
        assert all(abs(one - other) <= 2 for one, other in colours), name


def test_the_cache_holds_previews_by_content_and_options(site: Path) -> None:
    shutil.copy(PARROT, site / "a.png")
    shutil.copy(PARROT, site / "b.png")
    cache = site / "node_modules" / ".cache" / "sgmethod"
    (made,) = previews(site, ("a.png", {}))
    (kept,) = cache.iterdir()
    assert json.loads(kept.read_text()) == made
    kept.write_text('{ "text": "kept" }')
    elsewhere = {"cache": str(site / "other")}
    found = previews(site, ("b.png", {}), ("a.png", {"bytes": 64}), ("a.png", elsewhere), ("a.png", {"cache": False}))
    assert [one["text"] == "kept" for one in found] == [True, False, False, False]
    assert found[2] == found[3] == made
    assert len(list(cache.iterdir())) == 2
    Image.open(PARROT).rotate(180).save(site / "a.png")
    assert previews(site, ("a.png", {}))[0]["text"] not in ("kept", made["text"])
    kept.write_text("{ not whole")
    (site / "file").touch()  # where no folder can be
    assert previews(site, ("b.png", {}), ("b.png", {"cache": str(site / "file")})) == [made, made]


def test_bad_input_is_one_sentence(site: Path) -> None:
    (site / "text.jpg").write_text("no photograph")
    shutil.copy(PARROT, site / "a.png")
    found = previews(
        site,
        ("text.jpg", {}),
        ("none.jpg", {}),
        (5, {}),
        ("a.png", {"bits": 200}),
        ("a.png", {"bytes": 8}),
        ("a.png", {"characters": "many"}),
    )
    assert found[0].startswith("Error: text.jpg cannot be read: ")
    assert found[1].startswith("Error: ENOENT: no such file or directory, open 'none.jpg'")
    assert found[2].startswith("TypeError: photograph must be a path")
    assert found[3] == "TypeError: previewOf() has no option bits, only bytes, characters and cache"
    assert found[4] == "RangeError: bytes must be a whole number from 16 to 1024"
    assert found[5] == "RangeError: characters must be a number from 0 on"


def test_sharp_that_is_missing_is_named(tmp_path: Path) -> None:
    modules = tmp_path / "node_modules"
    modules.mkdir()
    shutil.unpack_archive(packed(), modules)
    (modules / "package").rename(modules / "sgmethod")
    shutil.copy(PARROT, tmp_path / "a.png")
    missing = "Error: previews need sharp 0.34 or later, which reads image files: npm install sharp"
    assert previews(tmp_path, ("a.png", {})) == [missing]
    (modules / "sharp").mkdir()  # an old one
    (modules / "sharp" / "package.json").write_text('{ "type": "module", "exports": "./index.js" }')
    (modules / "sharp" / "index.js").write_text("export default () => ({});")
    assert previews(tmp_path, ("a.png", {})) == [missing]


ELEVENTY = """
const { default: configure } = await import("./eleventy.config.mjs");
const addShortcode = async (name, made) => console.log(await made("photos/door.png", 'A "red" door'));
configure({ addPassthroughCopy() {}, addShortcode });
"""


def test_eleventy(site: Path) -> None:
    (site / "eleventy.config.mjs").write_text(code_in("docs/previews.md", heading="Eleventy")[0])
    (site / "photos").mkdir()
    shutil.copy(PARROT, site / "photos" / "door.png")
    printed = node(ELEVENTY, folder=site)
    size = 'width="128" height="96" loading="lazy" decoding="async"'
    style = r'style="background-image:url\(data:image/webp;base64,\S+\)"'
    img = rf'<img src="/photos/door.png" alt="A &quot;red&quot; door" {size} {style}>'
    found = re.fullmatch(rf'<sg-img preview="(\S+)">{img}</sg-img>\n', printed)
    assert found
    assert len(from_text(found[1])) <= 200


@pytest.mark.parametrize("document", ["docs/previews.md", "sgmethod/javascript/README.md"])
def test_a_page_in_one_script(each_browser: Page, site: Path, document: str) -> None:
    """The first steps of the documents."""
    (script,) = [code for code in code_in(document) if "writeFileSync(" in code]
    (site / "photos").mkdir()
    for name in ("photo.jpg", "photos/photo.jpg"):
        Image.open(PARROT).save(site / name)
    node(script, folder=site)
    with served(site) as here:
        each_browser.open(here.url)
        wait_until(lambda: [one["loaded"] for one in each_browser.run(SHOWN)] == [128])
        assert each_browser.run("return Boolean(customElements.get('sg-img'))")


CONFIGURATION = """
import { previews } from "sgmethod/vite";
export default { plugins: [previews({ bytes: 100 })], build: { assetsInlineLimit: 0 } };
"""
HTML = """
<!doctype html><title>A site</title>
<link rel="icon" href="data:,">
<main></main><script type="module" src="/main.ts"></script>
"""
MAIN = """
import first, { element } from "./photo.png?preview";
import { element as second } from "./photo.png?bytes=64&characters=0&preview";
const whole: { text: string; uri: string; width: number; height: number; color: string; dark: boolean } = first;
document.querySelector("main")!.innerHTML = element({ alt: `A parrot of ${whole.width}` }) + second({ alt: "Again" });
"""
TYPES = {"strict": True, "noEmit": True, "module": "esnext", "moduleResolution": "bundler", "skipLibCheck": False}
POLICY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
SHOWN = """
    return [...document.querySelectorAll("sg-img")].map((one) => ({
        text: one.getAttribute("preview"), drawn: Boolean(one.shadowRoot?.querySelector("canvas")),
        alt: one.querySelector("img").alt, loaded: one.querySelector("img").naturalWidth,
        uri: one.querySelector("img").style.backgroundImage, display: getComputedStyle(one).display,
    }));
"""


@pytest.fixture
def vite_site(site: Path) -> Path:
    for name, text in (("vite.config.js", CONFIGURATION), ("index.html", HTML), ("main.ts", MAIN)):
        (site / name).write_text(text)
    shutil.copy(PARROT, site / "photo.png")
    return site


@pytest.fixture
def built(vite_site: Path) -> Iterator[Site]:
    """What is built, with photographs held back."""
    with served(vite_site / "dist", POLICY) as site:
        site.may.clear()
        yield site


def test_a_build(each_browser: Page, vite_site: Path, built: Site) -> None:
    """With a strict policy, previews are there before the photographs. The second build makes none."""
    assert run("npx", "vite", "build", folder=vite_site).status == 0
    each_browser.open(built.url)
    wait_until(lambda: [one["drawn"] for one in each_browser.run(SHOWN)] == [True, True])
    first, second = each_browser.run(SHOWN)
    assert (first["alt"], second["alt"]) == ("A parrot of 128", "Again")
    assert [len(from_text(one["text"])) <= most for one, most in ((first, 100), (second, 64))] == [True, True]
    assert first["uri"].startswith('url("data:image/webp;base64,')
    assert second["uri"] == ""
    assert first["display"] == "block"
    assert first["loaded"] == 0
    built.may.set()
    wait_until(lambda: all(one["loaded"] == 128 and not one["drawn"] for one in each_browser.run(SHOWN)))
    assert each_browser.complaints() == []
    cached = list((vite_site / "node_modules" / ".vite" / "sgmethod").iterdir())
    assert len(cached) == 2
    for file in cached:
        file.write_text(json.dumps(json.loads(file.read_text()) | {"text": "kept"}))
    assert run("npx", "vite", "build", folder=vite_site).status == 0
    (bundle,) = (vite_site / "dist" / "assets").glob("index-*.js")
    assert bundle.read_text().count("kept") == 2


def answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


def test_a_development_server(each_browser: Page, vite_site: Path) -> None:
    """It shows previews, also of a photograph that changes."""
    port = free_port()
    command = ["node", "node_modules/vite/bin/vite.js", "--host", "127.0.0.1", "--port", str(port), "--strictPort"]
    with subprocess.Popen(command, cwd=vite_site, stdout=subprocess.DEVNULL) as server:
        try:
            wait_until(lambda: answers(port))
            each_browser.open(f"http://127.0.0.1:{port}/")
            found = wait_until(lambda: each_browser.run(SHOWN))
            assert [one["alt"] for one in found] == ["A parrot of 128", "Again"]
            wait_until(lambda: all(one["loaded"] for one in each_browser.run(SHOWN)))
            before = each_browser.run(SHOWN)[0]["text"]
            assert before == found[0]["text"]
            assert each_browser.run("return Boolean(customElements.get('sg-img'))")
            Image.open(PARROT).rotate(180).save(vite_site / "photo.png")
            wait_until(lambda: [one["text"] for one in each_browser.run(SHOWN) or []][:1] not in ([], [before]))
            assert [line for line in each_browser.complaints() if "[vite]" not in line] == []
        finally:
            server.terminate()


def test_errors_of_a_build_name_the_photograph(vite_site: Path) -> None:
    (vite_site / "photo.png").write_text("no photograph")
    done = run("npx", "vite", "build", folder=vite_site)
    assert done.status != 0
    assert re.search(r"photo\.png cannot be read: ", done.stderr)
    (vite_site / "main.ts").write_text(MAIN.replace("bytes=64", "bits=64"))
    shutil.copy(PARROT, vite_site / "photo.png")
    assert "previewOf() has no option bits" in run("npx", "vite", "build", folder=vite_site).stderr


def test_imports_have_types(vite_site: Path) -> None:
    """Where sgmethod/vite is among the types, or a file of the program imports it."""
    (vite_site / "wrong.ts").write_text('import one from "./photo.png?preview"; export const wide: string = one.width;')
    options = json.dumps({"compilerOptions": TYPES | {"types": ["sgmethod/vite"]}, "include": ["*.ts"]})
    (vite_site / "tsconfig.json").write_text(options)
    done = run("npx", "tsc", folder=vite_site)
    assert re.findall(r"^\S+", done.stdout, re.MULTILINE) == ["wrong.ts(1,53):"], done.stdout
