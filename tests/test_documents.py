"""The documents against the code: links and paths that lead somewhere, words that exist, forms that are kept."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
from pathlib import Path

import pytest

from tests.harness.data import ROOT

MOST_TERMS = 25
MOST_LINES, MOST_COLUMNS = 110, 120  # two printed pages
README_LINES, README_WORDS = 130, 1100
PARTS = ("Question", "Tried", "Figures", "Verdict")
NOTEBOOK = ROOT / "docs" / "notebook"
THEMES = sorted(set(NOTEBOOK.glob("*.md")) - {NOTEBOOK / "README.md"})
# Paths in backticks that begin so are files or folders of the tree.
FOLDERS = ("benchmarks", "docs", "service", "sgmethod", "tests")


def documents() -> list[Path]:
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"]
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listing.splitlines() if (ROOT / name).exists()]


def prose(path: Path) -> str:
    """The text without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)", prose(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def rows(text: str) -> list[list[str]]:
    """The cells of the tables in a text, without their heads."""
    bodies = re.findall(r"^\|[-|]+\|\n((?:\|.*\n)*)", text, re.MULTILINE)
    return [line.strip("| ").split(" | ") for body in bodies for line in body.splitlines()]


def glossary() -> tuple[list[list[str]], list[list[str]]]:
    """Rows of the words in use, and of those out of use."""
    in_use, out_of_use = (ROOT / "docs" / "glossary.md").read_text().split("## Out of use")
    return rows(in_use), rows(out_of_use)


def find(name: str) -> object:
    """What a dotted name stands for: the deepest module, then its attributes."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            found = getattr(found, part)
        return found
    raise AssertionError(f"nothing is called {name}")


@pytest.mark.parametrize("path", documents(), ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("path", documents(), ids=lambda path: str(path.relative_to(ROOT)))
def test_paths_in_documents_exist(path: Path) -> None:
    if "results" in path.parts:
        return  # they name what there was when they were measured
    named = re.findall(rf"`((?:{'|'.join(FOLDERS)})/[\w./-]*)`", prose(path))
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_curl_in_the_readmes_fails_when_the_service_does() -> None:
    """Or an error would lie in photo.sg; and it waits for less than the 60 s after which proxies give up."""
    for document in ("README.md", "service/README.md"):
        commands = re.findall(r"^curl .*", (ROOT / document).read_text(), re.MULTILINE)
        assert len(commands) > 1
        for command in commands:
            assert "--fail" in command, command
            assert all(int(seconds) < 60 for seconds in re.findall(r"wait=(\d+)", command)), command


def test_the_readme_is_read_in_a_minute() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= README_LINES
    assert len(text.split()) <= README_WORDS


def test_the_design_is_two_pages() -> None:
    lines = (ROOT / "docs" / "design.md").read_text().splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= MOST_COLUMNS


@pytest.mark.parametrize("path", THEMES, ids=lambda path: path.name)
def test_notebook_entries_have_their_four_parts(path: Path) -> None:
    entries = re.split(r"^## ", prose(path), flags=re.MULTILINE)[1:]
    assert entries
    for entry in entries:
        assert tuple(re.findall(r"^- \*\*(\w+)\.\*\*\s+[^\s-]", entry, re.MULTILINE)) == PARTS, entry.splitlines()[0]


def test_the_notebooks_index_has_every_question_and_its_verdict() -> None:
    questions = [
        (question, path.name) for path in THEMES for question in re.findall(r"^## (.*)", prose(path), re.MULTILINE)
    ]
    listed = re.findall(r"^- \[(.*)\]\((\w+\.md)#\S+\) \S.*\.$", (NOTEBOOK / "README.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(questions)


def test_the_glossary_is_short() -> None:
    words = [word for word, _, _ in glossary()[0]]
    assert 0 < len(words) <= MOST_TERMS
    assert len(set(words)) == len(words)


@pytest.mark.parametrize("name", sorted({name.strip("`") for _, _, name in glossary()[0]}))
def test_names_in_the_glossary_exist(name: str) -> None:
    find(name)


def test_words_out_of_use_stand_for_words_in_use() -> None:
    in_use, out_of_use = glossary()
    assert {word for _, word, _ in out_of_use} <= {word for word, _, _ in in_use}


@pytest.mark.parametrize("package", ["sgmethod", "service"])
def test_no_class_is_named_by_a_word_out_of_use(package: str) -> None:
    refused = {word for word, _, where in glossary()[1] if f"`{package}`" in where}
    assert refused
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                words = {word.lower() for word in re.findall(r"[A-Z]+[a-z0-9]*", node.name)}
                assert not words & refused, f"{path.relative_to(ROOT)}: {node.name}"
