"""The package as a type checker sees it: what the documents use is allowed, and a wrong word is an error."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.data import code_in

PAGES = "python.md", "datasets.md"
USES = """
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from typing_extensions import assert_type

import sgmethod
import sgmethod.torch
from sgmethod.client import Client

n, half, pixels = np.int64(8), np.float32(0.5), np.zeros((8, 8, 3), np.uint8)


def pictures() -> Iterator[tuple[str, bytearray]]:
    yield "a", bytearray()


for picture in ("a.png", Path("a.png"), b"", bytearray(), memoryview(b""), Image.new("L", (8, 8)), pixels / 255):
    sgmethod.encode(picture, bytes=n, effort=np.int8(1), time_limit_s=half, tune="psnr")
sgmethod.encode(pixels, bytes="20k")
sgmethod.encode(pixels, bpp=Fraction(1, 2), profile="rd")
sgmethod.encode(pixels, quality="web")
sgmethod.encode(pixels, quality=60, tune="vizual")  # type: ignore[arg-type]
sgmethod.encode(pixels, profile="rb")  # type: ignore[arg-type]
sgmethod.encode(pixels, quality="webb")  # type: ignore[arg-type]
sgmethod.encode(pixels, bytes=0.3)  # type: ignore[arg-type]
sgmethod.encode_many(["a.png", Path("b.png")], Path("out"), jobs=n)
sgmethod.encode_many(pictures(), "out", bytes="1k")
assert_type(sgmethod.Budget("bytes", n).value, float)
sgmethod.Budget("bits", 5)  # type: ignore[arg-type]
preview = sgmethod.preview(bytearray(), bytes="1k")

view = sgmethod.View(half, [0, 0, n, 8])
assert_type(view.region, tuple[int, int, int, int] | None)
for file in ("a.sg", Path("a.sg"), b"", bytearray(), memoryview(b""), preview.text):
    sgmethod.decode(file, view=view, width=n)
    sgmethod.open(file).pixels(half, region=np.array([0, 0, 8, 8]), height=n)
sgmethod.decode("a.sg", view)  # type: ignore[arg-type]
sgmethod.info(bytearray(), n)
sgmethod.set_threads(n)

sgmethod.Gaussians([[4, 4]], [[1, 0, 1]], [[1, 1, 1]])
means, factors, colors = torch.ones(1, 2), torch.ones(1, 3), torch.ones(1, 3)
gaussians = sgmethod.Gaussians(means, factors, colors)
sgmethod.Gaussians.from_covariances([[4, 4]], torch.ones(1, 2, 2), np.ones((1, 3)))
for background in ([0, 0, 0], (half, half, half), np.zeros(3), torch.zeros(3)):
    sgmethod.pack(gaussians, n, n, bpp=half, background=background, image=bytearray())
    sgmethod.torch.render(means, factors, colors, [n, n], background, half)
sgmethod.torch.fit(torch.zeros(1, 3, 8, 8), n, steps=n, quantum=half)
sgmethod.torch.fit(torch.zeros(1, 3, 8, 8), 5, steps="many")  # type: ignore[arg-type]
sgmethod.torch.SgDataset(["a.sg", bytearray()], size=[8, 8])
sgmethod.torch.fit_many([pixels, (pixels, 1)], "out", n, shard=n, device="cpu")

with Client("http://127.0.0.1:8000") as client:
    client.encode(bytearray(), sgmethod.Budget("bytes", "20k"), tune="visual", effort=n, time_limit_s=half)
    client.submit(b"", profile="rb")  # type: ignore[arg-type]
"""


@pytest.mark.thorough  # it takes a minute
def test_a_users_files_under_strict_rules(tmp_path: Path) -> None:
    """A comment that ignores an error which does not occur is an error too."""
    (tmp_path / "uses.py").write_text(USES)
    for page in PAGES:
        (tmp_path / f"{Path(page).stem}_examples.py").write_text("".join(code_in(f"docs/{page}", "python")))
    # Examples leave out annotations; torch and scikit-image have functions without.
    untyped = ["--allow-untyped-defs", "--allow-untyped-calls"]
    command = [sys.executable, "-m", "mypy", "--strict", *untyped, *sorted(tmp_path.glob("*.py"))]
    ran = subprocess.run(command, check=False, cwd=tmp_path, capture_output=True, text=True)
    assert ran.stdout == f"Success: no issues found in {1 + len(PAGES)} source files\n", ran.stdout + ran.stderr
