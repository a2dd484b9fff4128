"""The documents against the code: links that lead somewhere, names that exist."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
from pathlib import Path

from tests.support.data import ROOT


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


def leads_somewhere(path: Path, link: str) -> bool:
    name, _, anchor = link.partition("#")
    target = (path.parent / name).resolve() if name else path
    return target.exists() and (not anchor or anchor in anchors(target))


def test_links_lead_somewhere() -> None:
    written = re.compile(r"""\]\(([^)\s]+)\)|(?:src|href)="([^"]+)\"""")
    links = [(path, link or other) for path in documents() for link, other in written.findall(prose(path))]
    inner = [(path, link) for path, link in links if not re.match(r"[a-z]+:", link)]
    assert len(inner) > 100
    assert [f"{path.relative_to(ROOT)}: {link}" for path, link in inner if not leads_somewhere(path, link)] == []


def test_nginx_in_containers_asks_the_web_container() -> None:
    """And looks its name up again, as its address changes: .ci/containers tries it."""
    compose, text = (ROOT / "docs" / name for name in ("compose.public.yaml", "nginx.conf"))
    changes = re.findall(r"(-e) '(s/[^']*/)' ", compose.read_text())
    command = ["sed", *(word for change in changes for word in change), text]
    changed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert re.findall(r"^    listen [^#\n]*", changed, re.MULTILINE) == ["    listen 443 ssl;    "]
    assert len(re.findall(r"^    http2 on;$", changed, re.MULTILINE)) == 1
    servers = re.findall(r"^    (\w[^#\n]*\bserver [^;]*;)", changed, re.MULTILINE)
    assert servers == ["zone sgmethod 64k; resolver 127.0.0.11 valid=2s; server web:8000 resolve max_fails=0;"]


def test_the_notebooks_index_has_every_page() -> None:
    notebook = ROOT / "docs" / "notebook"
    listed = re.findall(r"^\| \[.*\]\((\w+\.md)\)", (notebook / "README.md").read_text(), re.MULTILINE)
    assert sorted([*listed, "README.md"]) == sorted(path.name for path in notebook.glob("*.md"))


def test_names_in_the_glossary_exist() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    names = re.findall(r"\| `([\w.]+)` \|$", text, re.MULTILINE)
    assert len(names) > 10
    for name in names:
        parts = name.split(".")
        found: object = importlib.import_module(".".join(parts[:2]))
        for k, part in enumerate(parts[2:], 3):
            found = getattr(found, part, None) or importlib.import_module(".".join(parts[:k]))


def functions(path: Path) -> set[str]:
    """The functions of a file, and its methods as Class.method, without importing what it needs."""
    tree = ast.parse(path.read_text())
    inner = {
        f"{one.name}.{part.name}"
        for one in tree.body
        if isinstance(one, ast.ClassDef)
        for part in one.body
        if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    return inner | {one.name for one in tree.body if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_the_calls_that_contributing_draws_pass_functions_that_exist() -> None:
    opening = (ROOT / "CONTRIBUTING.md").read_text().split("\n## ")[0]
    drawing = re.findall(r"^ +(\d+)  (\S+\.py) +([\w.]+)\(\)", opening, re.MULTILINE)
    numbers = [int(number) for number, _, _ in drawing]
    assert numbers == [*range(1, 10), *range(1, 7), *range(1, 11)]
    for _, file, name in drawing:
        assert name in functions(ROOT / file), name
    for path in re.findall(r"`((?:sgmethod|service|docs|benchmarks)/[\w./]*)`", opening):
        assert (ROOT / path).exists() or "NAME" in path, path
