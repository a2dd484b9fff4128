"""docs/python.md: its examples run, one after the other, and it has every name."""

from __future__ import annotations

import doctest
import re
from typing import Any

import pytest
import torch

import sgmethod
import sgmethod.torch
from sgmethod.metrics import psnr
from sgmethod.profiles import PROFILES
from tests.harness.data import ROOT
from tests.rd.short import short

PAGE = (ROOT / "docs" / "python.md").read_text()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encodes of less than a second."""
    monkeypatch.setitem(PROFILES, "rd", short(40))


@pytest.mark.usefixtures("files")
def test_the_examples() -> None:
    """Slow: eight examples, of which one fits by gradients and one trains."""
    torch.manual_seed(0)
    names: dict[str, Any] = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(examples) == 8
    for example in examples:
        exec(compile(example, "docs/python.md", "exec"), names)
    assert (names["tally"].encoded, names["tally"].failed) == (1, 0)
    assert names["corner"].shape == (64, 64, 3)
    levels = (255 * names["tensor"]).round().to(torch.uint8)
    assert torch.equal(levels, sgmethod.torch.decode("photo.sg"))
    fitted = sgmethod.decode(names["data"])
    assert psnr(fitted, (255 * names["picture"]).round().byte().permute(1, 2, 0).numpy()) > 24
    assert names["losses"][-1] < 0.8 * names["losses"][0]
    assert len(names["loader"]) == 1


@pytest.mark.parametrize("name", [*sgmethod.__all__, *(f"torch.{name}" for name in sgmethod.torch.__all__)])
def test_every_name_is_on_the_page(name: str) -> None:
    assert f"`{name}`" in PAGE.split("## All names")[1]


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("module", ["exchange.packing", "torch.drawing", "torch.files"])
def test_examples_in_docstrings(module: str) -> None:
    sgmethod.encode("photo.png").save("photo.sg")
    ran = doctest.testmod(__import__(f"sgmethod.{module}", fromlist=["x"]), extraglobs={"sgmethod": sgmethod})
    assert ran.attempted > 0
    assert ran.failed == 0
