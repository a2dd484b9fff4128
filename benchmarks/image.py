"""The Dockerfile's own steps in an empty Debian, without a container engine, and the service that comes of them.

    python -m benchmarks.image --folder FOLDER [--build-arg NAME=VALUE]... [--bind PATH]... [--out FILE]

Needs root, debootstrap (--debootstrap PROGRAM) and port 8000. In place of the base image stands an empty Debian of the
same release, with its own python3 as `python`. Each RUN, COPY, ENV, WORKDIR and USER is done as it is written, in a
root of its own for each stage. Then compose.yaml's `web` and `worker` run there, with its commands, environment, user
and volume, without capabilities; the image's health check, an encode and decodes follow, and SIGTERM ends both. --bind:
what the steps need of this machine to reach its package indexes.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import secrets
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import yaml  # type: ignore[import-untyped]
from PIL import Image

import sgmethod
from benchmarks.load.service import made_picture, png
from benchmarks.machine import RUNS, command, origin, write_json
from service.keys import digest
from tests.harness.data import ROOT

URL, PATIENCE_S = "http://127.0.0.1:8000", 60.0
USERLAND = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
PACKAGES = "python3,python3-venv,python3-dev,ca-certificates"  # what an image of Python has beside Debian
NETWORK = ("/etc/resolv.conf", "/etc/ssl/certs/ca-certificates.crt")
PASSED_ON = ("PIP_", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")


@dataclass
class Stage:
    """One FROM and what follows: its root, and what the instructions have set."""

    root: Path
    name: str
    variables: dict[str, str]
    folder: str = "/"
    user: str = "0:0"
    told: dict[str, Any] = field(default_factory=dict)


def instructions(text: str) -> list[tuple[str, str]]:
    """Words and what they are given, without comments, continued lines in one."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    joined = "\n".join(lines).replace("\\\n", " ")
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in joined.splitlines())]


def filled(text: str, variables: Mapping[str, str]) -> str:
    """With ${NAME} and $NAME in place."""
    for name in sorted(variables, key=len, reverse=True):
        text = text.replace(f"${{{name}}}", variables[name]).replace(f"${name}", variables[name])
    return text


class Builder:
    """Does the instructions. rows: what each took, in seconds."""

    def __init__(self, folder: Path, debootstrap: str, arguments: Mapping[str, str], bound: Sequence[str]) -> None:
        self._folder = folder
        self._debootstrap = debootstrap
        self._given = dict(arguments)
        self._bound = [path for path in (*NETWORK, *bound) if Path(path).exists()]
        self._known: dict[str, str] = {}
        self.stages: list[Stage] = []
        self.rows: list[dict[str, Any]] = []

    def build(self, dockerfile: Path) -> Stage:
        """The last stage."""
        for word, rest in instructions(dockerfile.read_text()):
            began = time.monotonic()
            getattr(self, f"_{word.lower()}")(rest)
            self._row(f"{word} {rest}", time.monotonic() - began)
        return self.stages[-1]

    def _row(self, step: str, seconds: float, **more: Any) -> None:
        self.rows.append({"step": " ".join(step.split())[:160], "seconds": round(seconds, 1), **more})
        print(self.rows[-1], flush=True)

    def _base(self) -> Path:
        """An empty Debian with its own Python, called as in the image."""
        base = self._folder / "base"
        if not base.exists():
            release = self._known["PYTHON_IMAGE"].rpartition("-")[2]
            words = [self._debootstrap, "--variant=minbase", f"--include={PACKAGES}", release, str(base)]
            began = time.monotonic()
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
            self._row(f"debootstrap {release}", time.monotonic() - began)
        python = base / "usr" / "local" / "bin" / "python"
        if not python.is_symlink():
            python.symlink_to("/usr/bin/python3")
        return base

    def _arg(self, rest: str) -> None:
        name, _, default = rest.partition("=")
        self._known[name] = self._given.get(name, default.strip('"'))

    def _from(self, rest: str) -> None:
        name = rest.partition(" AS ")[2] or "last"
        root = self._folder / name
        shutil.rmtree(root, ignore_errors=True)
        subprocess.run(["cp", "-a", str(self._base()), str(root)], check=True)
        self.stages.append(Stage(root, name, dict(USERLAND)))

    def _run(self, rest: str) -> None:
        stage = self.stages[-1]
        passed = {name: value for name, value in os.environ.items() if name.startswith(PASSED_ON)}
        words = {**passed, **self._known, **stage.variables}
        subprocess.run(self.inside(stage, ["sh", "-c", rest], words), check=True, stdout=subprocess.DEVNULL)

    def _copy(self, rest: str) -> None:
        stage, words = self.stages[-1], rest.split()
        *sources, to = [word for word in words if not word.startswith("--")]
        target = stage.root / str(Path(stage.folder, to)).lstrip("/")
        if words[0].startswith("--from="):
            (whence,) = (other for other in self.stages if f"--from={other.name}" == words[0])
            subprocess.run(["cp", "-a", str(whence.root / sources[0].lstrip("/")), str(target)], check=True)
            return
        listing = subprocess.run(
            ["git", "ls-files", "-z", *sources], cwd=ROOT, capture_output=True, text=True, check=True
        )
        for name in filter(None, listing.stdout.split("\0")):
            inside = Path(name).relative_to(sources[0]) if (ROOT / sources[0]).is_dir() else Path(name)
            (target / inside).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target / inside)

    def _env(self, rest: str) -> None:
        variables = self.stages[-1].variables
        for word in shlex.split(filled(rest, variables)):
            name, _, value = word.partition("=")
            variables[name] = value

    def _workdir(self, rest: str) -> None:
        stage = self.stages[-1]
        stage.folder = str(Path(stage.folder, rest))
        (stage.root / stage.folder.lstrip("/")).mkdir(parents=True, exist_ok=True)

    def _user(self, rest: str) -> None:
        self.stages[-1].user = rest

    def _told(self, word: str, rest: str) -> None:
        self.stages[-1].told[word] = rest if word == "expose" else json.loads(rest[rest.index("[") :])

    def _volume(self, rest: str) -> None:
        self.stages[-1].told["volume"] = rest

    def _expose(self, rest: str) -> None:
        self._told("expose", rest)

    def _healthcheck(self, rest: str) -> None:
        self._told("healthcheck", rest)

    def _entrypoint(self, rest: str) -> None:
        self._told("entrypoint", rest)

    def _cmd(self, rest: str) -> None:
        self._told("cmd", rest)

    def inside(
        self, stage: Stage, words: Sequence[str], variables: Mapping[str, str], volume: Path | None = None
    ) -> list[str]:
        """The command that runs the words in a stage's root, as its user, in name spaces of their own."""
        root, mounts = stage.root, []
        for path in self._bound:
            kind = "mkdir -p" if Path(path).is_dir() else "touch"
            mounts += [
                f"mkdir -p {root}{Path(path).parent}",
                f"{kind} {root}{path}",
                f"mount --bind {path} {root}{path}",
            ]
        if volume is not None:
            mounts.append(f"mount --bind {volume} {root}{stage.told['volume']}")
        user, group = stage.user.split(":")
        free = ["--no-new-privs", "--bounding-set=-all", "--inh-caps=-all"] if user != "0" else []
        become = ["setpriv", f"--reuid={user}", f"--regid={group}", "--clear-groups", *free]
        given = ["env", "-i", *(f"{name}={value}" for name, value in variables.items())]
        go = shlex.join(
            ["chroot", str(root), *become, *given, "sh", "-c", f'cd {stage.folder} && exec "$@"', "sh", *words]
        )
        mounts += [f"mount -t proc proc {root}/proc", f"mount --rbind /dev {root}/dev", f"exec {go}"]
        return ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-ec", "\n".join(mounts)]


class Composed:
    """The services of compose.yaml's first form, in the image's root."""

    def __init__(self, builder: Builder, stage: Stage, volume: Path, given: Mapping[str, str]) -> None:
        self._builder, self._stage, self._volume = builder, stage, volume
        self._services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
        self._given = given
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def command(self, words: Sequence[str], name: str = "web") -> list[str]:
        """What runs the words as that service does."""
        asked: dict[str, str] = self._services[name]["environment"]
        variables = {k: self._given.get(v.strip("${}").partition(":-")[0], "") for k, v in asked.items()}
        return self._builder.inside(self._stage, words, {**self._stage.variables, **variables}, self._volume)

    def start(self, name: str) -> None:
        """One service, with the image's entry point and the command of compose.yaml."""
        words = [*self._stage.told["entrypoint"], *self._services[name]["command"]]
        self._running[name] = subprocess.Popen(self.command(words, name))

    def stop(self) -> dict[str, int]:
        """SIGTERM to each, as an engine stops them; exit statuses."""
        for process in self._running.values():
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
            for child in children:
                os.kill(int(child), signal.SIGTERM)
        return {name: process.wait(PATIENCE_S) for name, process in self._running.items()}


def use(builder: Builder, stage: Stage) -> None:
    """Start the service, use it, stop it; a row for each step. Raises AssertionError."""
    key, volume = secrets.token_urlsafe(24), stage.root.with_name("volume")
    shutil.rmtree(volume, ignore_errors=True)
    subprocess.run(["cp", "-a", str(stage.root / stage.told["volume"].lstrip("/")), str(volume)], check=True)
    given = {"SG_API_KEYS": f"ann:{digest(key)}", "SG_LINK_SECRET": secrets.token_hex(32)}
    composed = Composed(builder, stage, volume, given)
    rows = builder.rows

    def step(name: str, began: float, **more: Any) -> None:
        rows.append({"step": name, "seconds": round(time.monotonic() - began, 2), **more})
        print(rows[-1], flush=True)

    began = time.monotonic()
    check = composed.command([*stage.told["entrypoint"], "check"])
    said = subprocess.run(check, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stdout + said.stderr
    step("check", began, said=said.stdout.splitlines())
    began = time.monotonic()
    for name in ("web", "worker"):
        composed.start(name)
    try:
        while subprocess.run(composed.command(stage.told["healthcheck"]), capture_output=True, check=False).returncode:
            assert time.monotonic() - began < PATIENCE_S, "the health check never passed"
            time.sleep(0.5)
        step("web and worker started, health check passed", began)
        _ask(key, step)
    finally:
        began, statuses = time.monotonic(), composed.stop()
        step("SIGTERM", began, exit_statuses=statuses)
    assert set(statuses.values()) == {0}, statuses


def _ask(key: str, step: Any) -> None:
    image = png(Image.fromarray(made_picture(768, 512)))
    with httpx.Client(base_url=URL, headers={"Authorization": f"Bearer {key}"}, timeout=300) as client:
        assert httpx.get(f"{URL}/jobs").status_code == 401
        began = time.monotonic()
        encoded = client.post("/encode?wait=250&bpp=0.3", content=image, headers={"Content-Type": "image/png"})
        assert encoded.status_code == 200, encoded.text
        job = encoded.headers["location"].rpartition("/")[2]
        figures = client.get(f"/jobs/{job}").json()["result"]
        step("POST /encode?wait=250&bpp=0.3", began, bytes=len(encoded.content), psnr=figures["psnr"])
        here = sgmethod.decode(encoded.content)
        link = client.post(f"/jobs/{job}/links").json()["decode_url"]
        asked: dict[str, Callable[[], httpx.Response]] = {
            "GET /decode/ID.png": lambda: client.get(f"/decode/{job}.png"),
            "POST /decode": lambda: client.post("/decode", content=encoded.content),
            "GET by a link, without a key": lambda: httpx.get(URL + link),
        }
        for name, ask in asked.items():
            began, answer = time.monotonic(), ask()
            pixels = np.asarray(Image.open(io.BytesIO(answer.content)))
            assert np.array_equal(pixels, here), f"{name}: other pixels than here"
            step(name, began, png_bytes=len(answer.content), pixels="as decoded here")
        for path in ("/livez", "/readyz", "/", "/docs"):
            assert client.get(path).status_code == 200, path


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="an empty folder for the roots, 8 GB")
    parser.add_argument("--build-arg", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--bind", action="append", default=[], metavar="PATH")
    parser.add_argument("--debootstrap", default="debootstrap")
    parser.add_argument("--out", type=Path, default=RUNS / "service" / "image.json")
    options = parser.parse_args()
    if os.geteuid() != 0:
        sys.exit("a root of one's own takes root")
    arguments = dict(word.split("=", 1) for word in options.build_arg)
    head = {"command": command("benchmarks.image"), **origin(), "remark": "", "settings": {"build_args": arguments}}
    builder = Builder(options.folder.resolve(), options.debootstrap, arguments, options.bind)
    stage = builder.build(ROOT / "Dockerfile")
    use(builder, stage)
    write_json(options.out, {**head, "rows": builder.rows})


if __name__ == "__main__":
    main()
