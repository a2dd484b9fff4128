"""The examples run as a reader runs them: each in a process, from a folder of its own."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

import sgmethod
from tests.support import processes
from tests.support.data import PHOTOGRAPHS, ROOT
from tests.support.service import Service

NAMES = sorted(path.stem for path in PHOTOGRAPHS.iterdir())

pytestmark = pytest.mark.thorough  # each imports and encodes in a process of its own


def run(folder: Path, name: str, *arguments: object) -> str:
    """What an example prints."""
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


def test_data_set_on_ray(tmp_path: Path) -> None:
    """On two nodes, of which one is killed midway: nothing is lost, and nothing is recorded twice."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    photos, out = tmp_path / "photos", tmp_path / "out"
    photos.mkdir()
    for number in range(24):
        shutil.copy(PHOTOGRAPHS / f"{NAMES[number % len(NAMES)]}.png", photos / f"{number:02}.png")
    program = (ROOT / "examples" / "data_set_on_ray.py").read_text().replace("SHARD = 100", "SHARD = 4")
    (tmp_path / "on_ray.py").write_text(program)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    lost = cluster.add_node(num_cpus=1)
    environment = {**os.environ, "RAY_ADDRESS": cluster.address}
    command = [sys.executable, "on_ray.py", "photos", "out"]
    try:
        running = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
        until = time.monotonic() + 120
        while len(list(out.glob("*/*.sg"))) < 6 and time.monotonic() < until:
            time.sleep(0.02)
        cluster.remove_node(lost, allow_graceful=False)
        first, _ = running.communicate(timeout=120)
        again = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    finally:
        cluster.shutdown()
    assert "0 failed, 0 shards left" in first.splitlines()[-1]
    assert again.stdout.splitlines()[-1].startswith("0 encoded, 24 there already, 0 failed")
    lines = [line for file in sorted(out.glob("*/manifest.jsonl")) for line in file.read_text().splitlines()]
    assert sorted(json.loads(line)["name"] for line in lines) == [f"{number:02}.sg" for number in range(24)]
    assert sorted(path.name for path in out.glob("*/*.sg")) == [f"{number:02}.sg" for number in range(24)]
