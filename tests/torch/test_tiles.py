"""The Triton kernels: interpreted on the CPU in a process of their own, and compiled for GPUs that need not be here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import torch

from sgmethod.torch.devices import has_tiles
from tests.support.data import ROOT

PARTS = {
    "tests/torch/interpreted.py": "",
    "tests/drawing/test_renderers.py": "tiles",
    "tests/backend/test_drawing.py": "tiles",
}
POINTERS = {"table": "i32", "levels": "i32", "counts": "i32", "ends": "i64", "keys": "i64", "starts": "i64"}
NUMBERS = {"reach", "floor", "scale", "mean_rate", "factor_rate", "color_rate", "beta1", "beta2", "least", "newton"}
FLAGS = ("pyramid", "lists", "draws", "enlarges", "compares")
KERNELS = ("place", "walk", "draw", "reduce", "gradients", "step")
TENSORS = re.findall(
    r"\w+",
    """means factors colors records planes sums coarse fine target errors by_means by_factors by_colors
    first second bias quanta prices""",
)


def test_devices_with_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    assert not has_tiles(torch.device("cpu"))
    assert not has_tiles(torch.device("meta"))


@pytest.mark.thorough
@pytest.mark.parametrize("path", PARTS)
def test_interpreted(path: str) -> None:
    """In a process of its own, as Triton decides when it is imported."""
    pytest.importorskip("triton", reason="the kernels for GPUs need Triton: pip install '.[gpu]'")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-k", PARTS[path], path]
    environment = {**os.environ, "TRITON_INTERPRET": "1", "OMP_NUM_THREADS": "1"}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-4000:]


def signature(kernel: Any, flags: dict[str, bool]) -> dict[str, str]:
    """Types of a kernel's arguments."""
    types = {}
    for name in (parameter.name for parameter in kernel.params):
        is_number = name in NUMBERS or (kernel.__name__ == "step" and name in ("width", "height"))
        if name in flags or name == "block":
            types[name] = "constexpr"
        elif name in POINTERS or name in TENSORS:
            types[name] = f"*{POINTERS.get(name, 'fp32')}"
        else:
            types[name] = "fp32" if is_number else "i32"
    return types


@pytest.mark.thorough
@pytest.mark.parametrize("name", KERNELS)
def test_compiled(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For an A100, an H100 and their like, down to the machine's code; single precision throughout."""
    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path))
    triton = pytest.importorskip("triton", reason="the kernels for GPUs need Triton: pip install '.[gpu]'")
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    from sgmethod.torch import tile_kernels

    kernel = getattr(tile_kernels, name)
    own = [parameter.name for parameter in kernel.params]
    switches = [flag for flag in FLAGS if flag in own]
    constants: dict[str, Any] = {"block": 128} if "block" in own else {}
    for values, capability in product(product((False, True), repeat=len(switches)), (80, 90)):
        flags = dict(zip(switches, values, strict=True))
        source = ASTSource(kernel, signature(kernel, flags), constexprs=flags | constants)
        options = {"num_warps": 1 if name == "walk" else 4, "enable_fp_fusion": True}
        compiled = triton.compile(source, target=GPUTarget("cuda", capability, 32), options=options)
        assert len(compiled.asm["cubin"]) > 0
        assert "f64" not in compiled.asm["ptx"]
