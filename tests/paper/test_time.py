"""Time limits of profile paper, and what would use them up."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import Any

import pytest
import torch

from sgmethod import Budget
from sgmethod.paper import encode as paper
from sgmethod.paper.adam import EPSILON, Adam
from tests.support.pictures import photo
from tests.support.profiles import encode_with


@pytest.mark.parametrize(("limit_s", "attempts"), [(0.3, 1), (None, 4)])
def test_no_further_attempt_starts_after_the_limit(
    limit_s: float | None, attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All four started, 8.4 s for a limit of 0.3 s on a photograph: to start one takes longest."""
    began = []
    run = paper.run

    def counted(*arguments: Any) -> Any:
        began.append(arguments)
        time.sleep(0.3)
        return run(*arguments)

    monkeypatch.setattr(paper, "run", counted)
    monkeypatch.setattr(paper, "USABLE_STEPS", 0)
    monkeypatch.setattr(paper, "_next_count", lambda tried, *_: 50 + len(tried))  # a new number each time
    settings = paper.PaperSettings(fit_steps=2, tune_steps=2)
    encode_with(settings, photo(), Budget("psnr", 60), time_limit_s=limit_s)
    assert len(began) == attempts


def test_nothing_slow_is_loaded_within_a_limit() -> None:
    """A limit of 20 s took 78 s on a busy machine: in the middle, PyTorch loaded a compiler and SymPy."""
    program = """
import sys
from PIL import Image
import sgmethod.paper.encode  # and PyTorch, for seconds
from sgmethod import encode
encode(Image.linear_gradient("L").resize((24, 24)), profile="paper", gaussians=5, time_limit_s=2.0)
print(sorted({"torch._dynamo", "sympy"} & set(sys.modules)))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout == "[]\n"


def test_adam_is_that_of_torch() -> None:
    """Bit by bit, with a rate for each tensor."""
    generator = torch.Generator().manual_seed(0)
    ours = [torch.randn(3, generator=generator), torch.randn(5, 1, generator=generator)]
    theirs = [one.clone() for one in ours]
    adam = Adam(ours, [0.1, 0.02], (0.9, 0.99))
    reference = torch.optim.Adam(
        [{"params": [one], "lr": rate} for one, rate in zip(theirs, (0.1, 0.02), strict=True)],
        betas=(0.9, 0.99),
        eps=EPSILON,
    )
    for _ in range(20):
        gradients = [torch.randn(one.shape, generator=generator) for one in ours]
        adam.step(gradients, 0.5)
        for group, gradient, rate in zip(reference.param_groups, gradients, (0.1, 0.02), strict=True):
            group["params"][0].grad, group["lr"] = gradient, rate * 0.5
        reference.step()
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))
