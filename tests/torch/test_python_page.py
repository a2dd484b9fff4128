"""docs/python.md and docs/datasets.md: their examples run, one after the other, and the first has every name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

import sgmethod
import sgmethod.torch
from sgmethod.metrics import psnr
from tests.support.data import ROOT, code_in
from tests.support.profiles import shorten

PAGE = (ROOT / "docs" / "python.md").read_text()


def ran(page: str) -> tuple[int, dict[str, Any]]:
    """The number of a page's examples, and the names that they leave."""
    names: dict[str, Any] = {}
    examples = code_in(f"docs/{page}", "python")
    for example in examples:
        exec(compile(example, f"docs/{page}", "exec"), names)
    return len(examples), names


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encodes of less than a second."""
    shorten(monkeypatch, 40)


@pytest.mark.usefixtures("files")
def test_the_examples() -> None:
    torch.manual_seed(0)
    number, names = ran("python.md")
    assert number == 9
    assert (names["tally"].encoded, names["tally"].failed) == (1, 0)
    assert names["corner"].shape == (64, 64, 3)
    levels = (255 * names["tensor"]).round().to(torch.uint8)
    assert torch.equal(levels, sgmethod.torch.decode("photo.sg"))
    fitted = sgmethod.decode(names["data"])
    assert psnr(fitted, (255 * names["picture"]).round().byte().permute(1, 2, 0).numpy()) > 24
    assert names["losses"][-1] < 0.8 * names["losses"][0]
    assert len(names["loader"]) == 1
    assert names["images"].shape == names["batch"].shape


@pytest.mark.thorough
@pytest.mark.usefixtures("files")
def test_the_page_of_data_sets() -> None:
    number, names = ran("datasets.md")
    assert number == 5
    assert len(list(Path("encoded").glob("*.sg"))) == 4
    assert names["right"] > 0.9


@pytest.mark.parametrize("name", ["open", *sgmethod.__all__, *(f"torch.{name}" for name in sgmethod.torch.__all__)])
def test_every_name_is_on_the_page(name: str) -> None:
    assert f"`{name}`" in PAGE.split("## All names")[1]
