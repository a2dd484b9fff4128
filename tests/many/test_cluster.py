"""encode_many() on a Ray cluster of two workers, one of which is killed. Slow: Ray takes seconds to start."""

from __future__ import annotations

import json
import os
import re
import secrets
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import sgmethod
from sgmethod import Row, SgError, Tally, encode_many
from sgmethod.many.cluster import in_ray
from tests.harness.data import ROOT
from tests.harness.pictures import png
from tests.many.killing import asleep, doubled, encode_killed_once, killed_once, process_of


@pytest.fixture(scope="module")
def token(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without one of its own, Ray would write one to the home folder."""
    path = tmp_path_factory.mktemp("ray") / "token"
    path.write_text(secrets.token_hex(32))
    return path


@pytest.fixture(scope="module")
def cluster(request: pytest.FixtureRequest, token: Path) -> Iterator[None]:
    """Two cores of this machine. Beyond a part of its memory, which a test may set, Ray kills what runs."""
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_TOKEN_PATH", str(token))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_memory_usage_threshold", getattr(request, "param", "0.95"))
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
        yield
        ray.shutdown()


@pytest.mark.usefixtures("cluster")
def test_killed_workers(tmp_path: Path) -> None:
    assert dict(in_ray(partial(killed_once, tmp_path), range(6), 4)) == {item: 2 * item for item in range(6)}
    assert dict(in_ray(doubled, [1, -1, 2], 4)) == {1: 2, -1: None, 2: 4}


@pytest.mark.usefixtures("cluster")
def test_the_same_manifest(tmp_path: Path) -> None:
    pictures = [("bad", b"hello"), *((str(number), png(32, 24, number)) for number in range(8))]
    ((_, victim),) = in_ray(process_of, [0], 1)

    def kill(_row: Row, tally: Tally) -> None:
        if tally.encoded == 1 and victim:
            os.kill(victim, signal.SIGKILL)

    options: dict[str, Any] = {"effort": 1, "gaussians": 9}
    tally = encode_many(pictures, tmp_path / "ray", jobs=2, engine="ray", on_row=kill, **options)
    assert (tally.encoded, tally.failed) == (8, 1)
    encode_many(pictures, tmp_path / "local", **options)
    assert manifest(tmp_path / "ray") == manifest(tmp_path / "local")
    for name in (f"{number}.sg" for number in range(8)):
        assert (tmp_path / "ray" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of Ray Data, by its own names
@pytest.mark.usefixtures("cluster")
def test_within_ray_data(tmp_path: Path) -> None:
    """The example of docs/python.md, of which a worker is killed."""
    ray = pytest.importorskip("ray.data")
    photos = tmp_path / "photos"
    photos.mkdir()
    for name, data in (("bad", b"hello"), *((str(number), png(32, 24, number)) for number in range(8))):
        (photos / name).write_bytes(data)
    (example,) = re.findall(r"```python\n(import ray\n.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL)
    stand_in = SimpleNamespace(set_threads=sgmethod.set_threads, SgError=SgError)
    stand_in.encode = partial(encode_killed_once, tmp_path)
    exec(example.replace("/data/", f"{tmp_path}/"), {"sgmethod": stand_in})
    assert (tmp_path / "killed").exists()
    rows = {Path(row["path"]).name: row for row in ray.read_parquet(str(tmp_path / "files")).take_all()}
    assert rows.pop("bad")["error"].startswith("the file is not a PNG")
    wanted = {path.name: sgmethod.encode(path, bpp=1).data for path in photos.iterdir() if path.name != "bad"}
    assert {name: row["file"] for name, row in rows.items()} == wanted
    assert all(row["psnr"] > 20 for row in rows.values())


@pytest.mark.parametrize("cluster", ["0.001"], indirect=True)
@pytest.mark.usefixtures("cluster")
def test_no_memory() -> None:
    """Ray kills whatever begins, and would begin it again for ever."""
    assert list(in_ray(asleep, [30], 1)) == [(30, None)]


def manifest(folder: Path) -> list[dict[str, Any]]:
    """Its lines by name, without times."""
    lines = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    for line in lines:
        line["figures"].pop("seconds", None)
    return sorted(lines, key=lambda line: str(line["name"]))


def test_engines_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SgError, match='the engine must be "local" or "ray", got \'dask\''):
        encode_many([], tmp_path, engine="dask")
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SgError, match="an extra package is needed"):
        encode_many([], tmp_path, engine="ray")
