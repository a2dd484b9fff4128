"""The examples run as a reader runs them: each in a process, from a folder of its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

import sgmethod
from tests.support import processes
from tests.support.data import PHOTOGRAPHS, ROOT
from tests.support.service import Service

NAMES = sorted(path.stem for path in PHOTOGRAPHS.iterdir())

pytestmark = pytest.mark.thorough  # each imports and encodes in a process of its own


def run(folder: Path, name: str, *arguments: object) -> str:
    ended = processes.run(sys.executable, ROOT / "examples" / name, *arguments, folder=folder)
    assert (ended.status, ended.stderr) == (0, "")
    return ended.stdout


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_usage(example: Path) -> None:
    for arguments in ([], ["--help"]):
        ended = processes.run(sys.executable, example, *arguments)
        assert (ended.status, ended.stdout) == (1, "")
        assert re.fullmatch(rf"usage: python {example.name} [A-Z].*\n", ended.stderr)


def test_contact_sheet(tmp_path: Path) -> None:
    run(tmp_path, "contact_sheet.py", PHOTOGRAPHS, "sheet.png")
    assert sorted(path.stem for path in (tmp_path / "sheet").glob("*.sg")) == NAMES
    assert all(path.stat().st_size <= 6000 for path in (tmp_path / "sheet").glob("*.sg"))
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert len(sheet.convert("L").crop((12, 12, 252, 252)).getcolors() or ()) > 50
    assert run(tmp_path, "contact_sheet.py", PHOTOGRAPHS, "sheet.png") == ""  # all are there


def test_thumbnails(tmp_path: Path) -> None:
    assert len(run(tmp_path, "thumbnails.py", PHOTOGRAPHS, "small").splitlines()) == len(NAMES)
    for name in NAMES:
        info = sgmethod.info(tmp_path / "small" / f"{name}.png.sg")
        assert max(info.width, info.height) <= 320


def test_fit_in_torch(tmp_path: Path) -> None:
    output = run(tmp_path, "fit_in_torch.py", PHOTOGRAPHS / "kodim23-crop.png", "photo.sg")
    errors = [float(error) for error in re.findall(r"absolute error (\S+)", output)]
    assert errors[-1] < errors[0]
    assert sgmethod.info(tmp_path / "photo.sg").gaussians > 500


def test_static_page(tmp_path: Path) -> None:
    printed = run(tmp_path, "static_page.py", PHOTOGRAPHS, "site")
    assert printed.strip() == f"{Path('site', 'index.html')}, photographs: {len(NAMES)}"
    html = (tmp_path / "site" / "index.html").read_text()
    assert html.count("<sg-img preview=") == len(NAMES)
    assert (tmp_path / "site" / "sgmethod" / "sg-img.js").exists()
    assert all((tmp_path / "site" / "photos" / f"{name}.png.webp").exists() for name in NAMES)


def test_django(tmp_path: Path) -> None:
    pytest.importorskip("django")
    photographs = sorted(PHOTOGRAPHS.iterdir())
    assert run(tmp_path, "django_photos.py", "data", *photographs).count("preview") == len(NAMES)
    ask = f"""
        import runpy, sys
        sys.argv = ["django_photos.py", "data"]
        site = runpy.run_path({str(ROOT / "examples" / "django_photos.py")!r}, run_name="site")
        print(site["index"](None).content.decode())
    """
    program = "\n".join(line.strip() for line in ask.splitlines())
    ended = processes.run(sys.executable, "-c", program, folder=tmp_path)
    assert ended.stdout.count("<sg-img preview=") == len(NAMES), ended.stderr


def test_bulk_client(tmp_path: Path) -> None:
    service = Service(tmp_path / "data")
    try:
        for summary in ("3 encoded, 0 there already, 0 failed", "0 encoded, 3 there already, 0 failed"):
            assert summary in run(tmp_path, "bulk_client.py", service.url, PHOTOGRAPHS, "out")
    finally:
        service.stop()
    assert sorted(path.stem for path in (tmp_path / "out").glob("*.sg")) == NAMES


def nodes_of_ray() -> tuple[str, Callable[[], None], Callable[[], None]]:
    """The address of a cluster with two nodes, and how to kill one and to end all."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    lost = cluster.add_node(num_cpus=1)
    return cluster.address, lambda: cluster.remove_node(lost, allow_graceful=False), cluster.shutdown


def nodes_of_dask() -> tuple[str, Callable[[], None], Callable[[], None]]:
    pytest.importorskip("distributed")
    from distributed import LocalCluster

    cluster = LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None)
    return cluster.scheduler_address, lambda: os.kill(cluster.workers[1].pid, signal.SIGKILL), cluster.close


@pytest.mark.parametrize(("kind", "cluster"), [("ray", nodes_of_ray), ("dask", nodes_of_dask)])
def test_data_set_on_a_cluster(tmp_path: Path, kind: str, cluster: Callable[..., Any]) -> None:
    """On two nodes, of which one is killed midway: nothing is lost, and nothing is recorded twice."""
    names = [f"{number:02}" for number in range(24)]
    (tmp_path / "photos").mkdir()
    for number, name in enumerate(names):
        with Image.open(PHOTOGRAPHS / f"{NAMES[number % len(NAMES)]}.png") as photo:
            photo.resize((24, 18)).save(tmp_path / "photos" / f"{name}.png")
    address, kill_one, end = cluster()
    program = ROOT / "examples" / "data_set_on_cluster.py"
    command = [sys.executable, str(program), "photos", "out", kind, address]
    try:
        running = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        assert running.stdout
        lines = [running.stdout.readline() for _ in range(6)]
        kill_one()
        lines += running.stdout.readlines()
        assert running.wait() == 0
        again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    finally:
        end()
    assert "24 encoded, 0 there already, 0 failed\n" in lines  # Ray ends with an empty line
    assert again.stdout.splitlines()[-1] == "0 encoded, 24 there already, 0 failed"
    rows = [json.loads(line) for line in (tmp_path / "out" / "manifest.jsonl").read_text().splitlines()]
    assert sorted(row["name"] for row in rows) == [f"{name}.sg" for name in names]
    assert sorted(path.stem for path in (tmp_path / "out").glob("*.sg")) == names
