"""The page and the list of formats against the formats that there are."""

from __future__ import annotations

import re
from pathlib import Path

from service.pictures import WRITERS
from sgmethod.io import kinds
from sgmethod.io.formats import ALL, FORMATS, OTHER_SUFFIXES, REFUSED, SUFFIXES
from tests.support.data import ROOT


def test_the_page_recognises_every_format() -> None:
    images = re.search(r"const IMAGES = (.*?);", (ROOT / "service/page/kinds.js").read_text(), re.DOTALL)
    assert images is not None
    assert set(re.findall(r'^  \["(.*?)"', images[1], re.MULTILINE)) == set(FORMATS)
    offered = re.findall(r'<option value="(\w+)">', (ROOT / "service/page/index.html").read_text())
    assert set(WRITERS) <= set(offered)


def test_what_is_read_is_in_no_list_of_what_is_not() -> None:
    assert SUFFIXES.isdisjoint(OTHER_SUFFIXES)
    for magics in REFUSED.values():
        assert not [one.name for one in ALL for magic in magics if one.begins(magic)]


def test_every_module_of_a_format_is_listed() -> None:
    folder = Path(kinds.__path__[0])
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__", "format"}
    assert modules == {one.name.lower().replace(" ", "_") for one in ALL}
