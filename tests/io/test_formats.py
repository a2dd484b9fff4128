"""Every list of picture formats, in the page and in the documents, against the formats that there are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from service.pictures import WRITERS
from sgmethod.io import kinds, pictures
from sgmethod.io.formats import ALL, EXTRA, FORMATS, OTHER_SUFFIXES, PLAIN, REFUSED, SUFFIXES, WRITTEN, listed
from sgmethod.io.kinds.format import Writer
from tests.support.data import ROOT

LIMITED = {name: f"{writer.max_side:,}" for name, writer in WRITTEN.items() if writer.max_side != Writer(()).max_side}
LOSSLESS = [name for name, writer in WRITTEN.items() if not writer.options]
OTHERS = {kind: writer for kind, writer in WRITERS.items() if kind != "png"}
SERVED = [f"`.{kind}`{'' if writer.has_alpha else ' (over white)'}" for kind, writer in OTHERS.items()]
EXTRAS = [f"`{one.extra}`" for one in ALL if one.extra]
QUALITIES = [f"{writer.quality} for `{kind}`" for kind, writer in WRITERS.items() if writer.quality]


def with_alpha(has_alpha: bool) -> list[str]:
    return [name for name, writer in WRITTEN.items() if writer.has_alpha is has_alpha]


SENTENCES = {
    "docs/limits.md": (
        f"- Input: {listed(PLAIN)}; {listed(EXTRA)} with their [extras](install.md).",
        f"Decoded {listed(LIMITED)} files have at most {listed(LIMITED.values())} pixels per side.",
        f"and {listed(with_alpha(True), 'or')} as output:",
        f"and {listed(with_alpha(False))} composite it over white.",
    ),
    "docs/command_line.md": (
        f"the output: {listed((f'`{writer.suffixes[0]}`' for writer in WRITTEN.values()), 'or')}. "
        f"{listed(LOSSLESS)} store the exact pixels;",
        f"| output formats | {', '.join(WRITTEN)} |",
    ),
    "docs/install.md": (
        *(f"'.[{one.extra}]'` | reading {one.name};" for one in ALL if one.extra),
        f"For {listed(EXTRA)}, add {listed(f'`--hidden-import {FORMATS[name].reader[0]}`' for name in EXTRA)}.",
    ),
    "service/README.md": (
        f"the decoded picture; also {listed(SERVED)}, or, without an extension,",
        f"`image`: {listed(PLAIN, 'or')}; {listed(EXTRA)} with the extras {listed(EXTRAS)},",
        f"on the scale of the encoder; by default {listed(QUALITIES)} |",
    ),
    "service/page/index.html": (
        "".join(f'<option value="{kind}">{pictures.SUFFIXES[f".{kind}"]}</option>' for kind in WRITERS),
    ),
}


@pytest.mark.parametrize(("document", "sentence"), [(name, one) for name in SENTENCES for one in SENTENCES[name]])
def test_a_list_names_every_format(document: str, sentence: str) -> None:
    """Lists are the tests' own: put what is missing into the document."""
    assert sentence in " ".join((ROOT / document).read_text().split())


def test_the_page_recognises_every_format() -> None:
    images = re.search(r"const IMAGES = (.*?);", (ROOT / "service/page/kinds.js").read_text(), re.DOTALL)
    assert images is not None
    assert set(re.findall(r'^  \["(.*?)"', images[1], re.MULTILINE)) == set(FORMATS)


def test_what_is_read_is_in_no_list_of_what_is_not() -> None:
    assert SUFFIXES.isdisjoint(OTHER_SUFFIXES)
    for magics in REFUSED.values():
        assert not [one.name for one in ALL for magic in magics if one.begins(magic)]


def test_every_module_of_a_format_is_listed() -> None:
    folder = Path(kinds.__path__[0])
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__", "format"}
    assert modules == {one.name.lower().replace(" ", "_") for one in ALL}
