"""Production builds by versions of Vite, frameworks and bundlers that docs/previews.md names, opened in a browser."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from PIL import Image

from sgmethod.bitstream.text import from_text
from tests.javascript.site import SHOWN, answers, served
from tests.javascript.test_bundlers import HTML, PARROT
from tests.support.browser import Chromium
from tests.support.data import code_in
from tests.support.node import install, packed
from tests.support.processes import free_port, run, wait_until

pytestmark = pytest.mark.thorough

VITE = """
import { previews } from "sgmethod/vite";
export default { plugins: [previews()], build: { assetsInlineLimit: 0 } };
"""
MAIN = """
import { element } from "./door.jpg?preview";
document.querySelector("main").innerHTML = element({ alt: "A red door" });
"""


def recipe(heading: str, *places: int) -> list[str]:
    """Blocks of a framework's code in the document."""
    blocks = code_in("docs/previews.md", heading=heading)
    return [blocks[place] for place in places]


@dataclass(frozen=True)
class Build:
    """A site by a version of a framework.

    node: the oldest version of Node on which it runs.
    folder: what a server of static files serves; without, the command `server` serves the site.
    """

    packages: str
    photo: str
    files: dict[str, str]
    build: str
    folder: str = ""
    server: str = ""
    node: int = 20


def vite(version: int) -> Build:
    files = {"vite.config.js": VITE, "index.html": HTML.replace("main.ts", "main.js"), "main.js": MAIN}
    return Build(f"vite@{version}", "door.jpg", files, "vite build", folder="dist")


def astro(version: int, node: int) -> Build:
    configuration, page = recipe("Astro", 0, 1)
    files = {"astro.config.mjs": configuration, "src/pages/index.astro": page}
    return Build(f"astro@{version}", "src/assets/door.jpg", files, "astro build", folder="dist", node=node)


def svelte_kit() -> Build:
    configuration, page = recipe("SvelteKit", 0, 1)
    imports = 'import { sveltekit } from "@sveltejs/kit/vite";\nimport { defineConfig } from "vite";\n'
    adapter = 'import adapter from "@sveltejs/adapter-static";\nexport default { kit: { adapter: adapter() } };'
    files = {
        "vite.config.ts": imports + configuration,
        "svelte.config.js": adapter,
        "src/app.html": "<!doctype html>%sveltekit.head%<body>%sveltekit.body%</body>",
        "src/routes/+layout.js": "export const prerender = true;",
        "src/routes/+page.svelte": page,
    }
    packages = "@sveltejs/kit@2 @sveltejs/adapter-static@3 @sveltejs/vite-plugin-svelte@6 svelte@5 vite@7"
    return Build(packages, "src/lib/door.jpg", files, "vite build", folder="build")


def react_router() -> Build:
    (door,) = recipe("React with Vite", 0)
    configuration = """
        import { reactRouter } from "@react-router/dev/vite";
        import { previews } from "sgmethod/vite";
        export default { plugins: [previews(), reactRouter()] };
    """
    root = """
        import { Links, Meta, Outlet, Scripts } from "react-router";
        export default () => (
          <html lang="en"><head><Meta /><Links /></head><body><Outlet /><Scripts /></body></html>
        );
    """
    files = {
        "vite.config.js": configuration,
        "app/root.tsx": root,
        "app/routes.ts": 'import { index } from "@react-router/dev/routes";\nexport default [index("door.tsx")];',
        "app/door.tsx": f"{door}\nexport default Door;",
    }
    parts = ("react-router", *(f"@react-router/{part}" for part in ("dev", "node", "serve")))
    packages = " ".join(f"{part}@7.18.4" for part in parts)  # they only go together
    packages += " react@19 react-dom@19 isbot@5 vite@7 typescript@5"
    server = "@react-router/serve/bin.js build/server/index.js"
    return Build(packages, "app/door.jpg", files, "react-router build", server=server)


def next_js(version: int, options: str, configuration: str = "export default {};") -> Build:
    layout, page = recipe("Next.js", 1, 2)
    bundler = '{ "compilerOptions": { "moduleResolution": "bundler" } }'  # as create-next-app has it
    files = {"next.config.mjs": configuration, "app/layout.tsx": layout, "app/page.tsx": page, "tsconfig.json": bundler}
    packages = f"next@{version} react@19 react-dom@19 typescript@5 @types/react@19 @types/node@20"
    server = "next/dist/bin/next start --hostname 127.0.0.1"
    return Build(packages, "public/door.jpg", files, f"next build {options}", server=server)


BUILDS = {
    "Vite 6": vite(6),
    "Vite 7": vite(7),
    "Vite 8": vite(8),
    "Astro 5": astro(5, 20),
    "Astro 6": astro(6, 22),
    "Astro 7": astro(7, 22),
    "SvelteKit 2": svelte_kit(),
    "React Router 7": react_router(),
    "Next.js 15 with webpack": next_js(15, ""),
    "Next.js 15 with Turbopack": next_js(15, "--turbopack", *recipe("Next.js", 0)),
    "Next.js 16 with webpack": next_js(16, "--webpack"),
    "Next.js 16 with Turbopack": next_js(16, "", *recipe("Next.js", 0)),
}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Path]]:
    """A folder with packages, the same for all builds that need the same; they are large, so none stays."""
    folders: dict[str, Path] = {}

    def installed(packages: str) -> Path:
        if packages not in folders:
            folder = tmp_path_factory.mktemp("site")
            install(folder, packed(), "sharp@0.35", *packages.split())
            folders[packages] = folder
        return folders[packages]

    yield installed
    for folder in folders.values():
        shutil.rmtree(folder)


@contextmanager
def running(build: Build, folder: Path) -> Iterator[str]:
    """The address of a site that was built."""
    if build.folder:
        with served(folder / build.folder) as site:
            yield site.url
        return
    port = free_port()
    command = ["node", *f"node_modules/{build.server}".split()]
    environment = os.environ | {"PORT": str(port), "HOST": "127.0.0.1"}
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL) as server:
        try:
            wait_until(lambda: answers(port) or server.poll() is not None)
            yield f"http://127.0.0.1:{port}/"
        finally:
            server.terminate()


@pytest.mark.parametrize("name", BUILDS)
def test_a_production_build_shows_previews(page: Chromium, installed: Callable[[str], Path], name: str) -> None:
    build = BUILDS[name]
    version = run("node", "--version").stdout.strip()
    if int(version[1:].split(".")[0]) < build.node:
        pytest.skip(f"{name} needs Node {build.node} or later, and this is {version}")
    folder = installed(build.packages)
    for path, text in build.files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    (folder / build.photo).parent.mkdir(parents=True, exist_ok=True)
    Image.open(PARROT).convert("RGB").save(folder / build.photo, quality=95)
    if name.startswith("Next.js"):
        for file in ("sg-img.js", "sg-img.css"):
            shutil.copy(folder / "node_modules" / "sgmethod" / "dist" / file, folder / "public")
    done = run("npx", *build.build.split(), folder=folder, NEXT_TELEMETRY_DISABLED=1, ASTRO_TELEMETRY_DISABLED=1)
    assert done.status == 0, done.stdout + done.stderr
    assert re.findall("Warning:.*sgmethod.*", done.stdout + done.stderr) == []
    with running(build, folder) as url:
        page.open(url)
        wait_until(lambda: [(one["loaded"], one["drawn"]) for one in page.run(SHOWN)] == [(128, False)])
        (shown,) = page.run(SHOWN)
        assert (shown["alt"], shown["display"]) == ("A red door", "grid")
        assert len(from_text(shown["text"])) <= 200
        wait_until(lambda: page.run("return Boolean(customElements.get('sg-img'))"))
        assert [line for line in page.complaints() if "favicon.ico" not in line] == []


SERVER = """
import { previewOf } from "sgmethod/node";
const made = await Promise.all([64, 200].map((bytes) => previewOf("door.jpg", { bytes, cache: false })));
console.log(JSON.stringify(made));
"""
WEBPACK = """
export default { mode: "production", target: "node", entry: "./server.mjs", externals: { sharp: "import sharp" },
  experiments: { outputModule: true }, output: { path: import.meta.dirname, filename: "built.mjs", module: true } };
"""
ESBUILD = "esbuild server.mjs --bundle --platform=node --format=esm --external:sharp --outfile=built.mjs"
BUNDLERS = {"esbuild": ("esbuild@0.28", ESBUILD), "webpack": ("webpack@5 webpack-cli@7", "webpack")}


@pytest.mark.parametrize("bundler", BUNDLERS)
def test_a_server_of_one_file_makes_previews(installed: Callable[[str], Path], bundler: str) -> None:
    """A worker's file is not beside it, so previews are made in its only thread. They are the same. A worker of the
    server's own is left alone."""
    packages, build = BUNDLERS[bundler]
    folder = installed(packages)
    (folder / "server.mjs").write_text(SERVER)
    (folder / "webpack.config.mjs").write_text(WEBPACK)
    (folder / "worker.js").write_text('import { writeFileSync } from "node:fs"; writeFileSync("started", "");')
    Image.open(PARROT).convert("RGB").save(folder / "door.jpg")
    done = run("npx", *build.split(), folder=folder)
    assert done.status == 0, done.stdout + done.stderr
    plain, built = (run("node", file, folder=folder) for file in ("server.mjs", "built.mjs"))
    assert built.status == 0, built.stderr
    assert len(json.loads(built.stdout)) == 2
    assert built.stdout == plain.stdout
    assert not (folder / "started").exists()
