"""sgmethod/vite of the npm package: in builds and on a development server."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

from sgmethod.bitstream.text import from_text
from tests.javascript.site import SHOWN, Site, answers, served
from tests.support.browser import Page
from tests.support.data import PHOTOGRAPHS
from tests.support.node import answer_of
from tests.support.processes import free_port, run, wait_until

pytestmark = pytest.mark.thorough

PARROT = PHOTOGRAPHS / "kodim23-crop.png"
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


@pytest.fixture
def vite_site(npm_site: Path) -> Path:
    for name, text in (("vite.config.js", CONFIGURATION), ("index.html", HTML), ("main.ts", MAIN)):
        (npm_site / name).write_text(text)
    shutil.copy(PARROT, npm_site / "photo.png")
    return npm_site


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
    assert first["display"] == "grid"
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
            wait_until(lambda: each_browser.run("return Boolean(customElements.get('sg-img'))"))
            Image.open(PARROT).rotate(180).save(vite_site / "photo.png")
            wait_until(lambda: [one["text"] for one in each_browser.run(SHOWN) or []][:1] not in ([], [before]))
            assert [line for line in each_browser.complaints() if "[vite]" not in line] == []
        finally:
            server.terminate()


OUTSIDE = """
import { createServer } from "vite";
const fs = { allow: ["."] };
const server = await createServer({ server: { host: "127.0.0.1", port: given.port, fs }, logLevel: "silent" });
await server.listen();
const statuses = [];
for (const query of ["?import&preview", "?import&bytes=64&preview", ""]) {
  const answer = await fetch(`http://127.0.0.1:${given.port}/@fs${given.outside}${query}`);
  statuses.push([answer.status, (await answer.text()).includes("data:image/webp")]);
}
await server.close();
console.log(JSON.stringify(statuses));
process.exit();
"""


def test_a_development_server_opens_nothing_outside(vite_site: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """It refuses photographs outside server.fs.allow, as Vite does, and goes on refusing them."""
    outside = tmp_path_factory.mktemp("outside") / "secret.png"
    shutil.copy(PARROT, outside)
    asked = {"port": free_port(), "outside": str(outside)}
    assert answer_of(OUTSIDE, asked, vite_site) == [[403, False]] * 3
    asked["outside"] = str(vite_site / "photo.png")
    assert answer_of(OUTSIDE, asked, vite_site) == [[200, True], [200, True], [200, False]]


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
