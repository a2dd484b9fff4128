"""Data flows one way: a package imports only from those above it in the list that opens its parent's docstring."""

from __future__ import annotations

import ast
import builtins
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from importlib.metadata import version
from pathlib import Path

import pytest

import service
import sgmethod
from tests.support.data import PHOTOGRAPHS, ROOT, golden_path

FACES = {"sgmethod": sgmethod.__doc__ or "", "service": service.__doc__ or ""}


def listed(package: str) -> list[str]:
    """The packages and modules of a package, as its docstring lists them; packages end in a slash."""
    return re.findall(r"^    (\S+)  *\S", FACES[package], re.MULTILINE)


def modules(package: str) -> dict[str, Path]:
    """Files of a package by dotted name, without its face and its command."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        if len(parts) > 1 and parts[1:] != ("__main__",):
            found[".".join(parts)] = path
    return found


def entry_of(module: str) -> str:
    """The entry of the list that a module belongs to: the deepest package that holds it."""
    package, *parts = module.split(".")
    path = "/".join(parts) + "/"
    entries = [entry for entry in listed(package) if path.startswith(entry if entry.endswith("/") else entry + "/")]
    return max(entries, key=len, default="")


def imports_of(path: Path, known: set[str]) -> set[str]:
    """Modules of the same package imported anywhere in a file: at its top, in functions, for types."""
    package = path.relative_to(ROOT).parts[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno} imports relatively"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else node.module or "" for name in inner}
    return {name for name in found if name.split(".")[0] == package}


MODULES = {name: path for package in FACES for name, path in modules(package).items()}
IMPORTS = {name: imports_of(path, {*MODULES, "sgmethod.native._native"}) for name, path in MODULES.items()}


@pytest.mark.parametrize("package", FACES)
def test_every_package_is_listed_and_exists(package: str) -> None:
    found = {entry_of(name) for name in MODULES if name.startswith(package + ".")}
    assert "" not in found
    assert set(listed(package)) == found


def test_imports_come_from_above_and_in_no_circle() -> None:
    """Modules of one package may import each other, but none its __init__ instead of a module."""
    assert "sgmethod.codec" in IMPORTS["sgmethod.cli.encoding"]  # within a function
    assert set(IMPORTS) <= set(TopologicalSorter(IMPORTS).static_order())  # raises CycleError
    order = {name: [*listed(name)].index for name in FACES}
    wrong = [
        f"{module} imports {other}"
        for module, imports in IMPORTS.items()
        for place in [order[module.split(".")[0]]]
        for other in imports
        if other in FACES or place(entry_of(other)) > place(entry_of(module))
    ]
    assert wrong == []


def test_native_folders_include_from_above() -> None:
    """In the order in which the native package's text names them."""
    native = ROOT / "sgmethod" / "native"
    order = re.findall(r"(\w+)/", (ast.get_docstring(ast.parse((native / "__init__.py").read_text())) or ""))
    sources = [path for path in native.rglob("*.*") if path.suffix in (".h", ".cpp")]
    assert set(order) == {path.parent.name for path in sources}
    included = 0
    for path in sources:
        for name in re.findall(r'^#include "(\w+)/', path.read_text(), re.MULTILINE):
            assert order.index(name) <= order.index(path.parent.name), f"{path} includes {name}/"
            included += 1
    assert included > 50


def sources(*places: str) -> dict[str, str]:
    """The text of each Python file below these folders, or of these files."""
    found = {}
    for place in places:
        paths = [ROOT / place] if place.endswith(".py") else sorted((ROOT / place).rglob("*.py"))
        assert paths, place
        found |= {str(path.relative_to(ROOT)): path.read_text() for path in paths}
    return found


IMPORT = r"^\s*(from|import) "
# Where it is looked for, what, and the only files or folders that may have it.
RULES = {
    "the service leaves the encoder to confined processes": (
        "service",
        r"sgmethod\.(codec|rd|paper|fitting|start|previews)\b|from sgmethod import .*\b(codec|encode|preview)\b",
        "service/sandbox/tasks.py",
    ),
    "only tensors, which nothing needs, and profile paper import PyTorch": (
        "sgmethod service",
        IMPORT + r"((sgmethod\.)?torch|triton)\b|from sgmethod import .*\btorch\b",
        "sgmethod/paper/ sgmethod/torch/",
    ),
    "profile paper is imported by itself alone": (
        "sgmethod service",
        IMPORT + r"sgmethod\.paper\b|from sgmethod import .*\bpaper\b",
        "sgmethod/paper/",
    ),
    "the registry of profiles alone names it": (
        "sgmethod service",
        r"\bprofile paper\b|[\"'./]paper[\"'./]|PaperS",
        "sgmethod/__init__.py sgmethod/profiles.py sgmethod/paper/",
    ),
    "only the job table speaks SQL": (
        "service",
        r"\b(SELECT|INSERT INTO|DELETE FROM|UPDATE jobs)\b|^\s*(from|import) (sqlite3|psycopg)\b",
        "service/jobs/",
    ),
    "the loop of a fit knows no clock and no file": (
        "sgmethod/rd/densify.py sgmethod/rd/fit.py sgmethod/rd/levels.py sgmethod/rd/state.py",
        IMPORT + r"(time|sgmethod\.(bitstream|fitting\.recorder|rd\.(schedule|search|steer))|.*\b(Deadline|Clock))\b",
        "",
    ),
    "the encoder computes through its backend": (  # and the reader of profile paper's files draws
        "sgmethod/rd sgmethod/fitting sgmethod/paper",
        IMPORT + r"sgmethod\.native",
        "sgmethod/paper/stream.py",
    ),
}


@pytest.mark.parametrize("rule", RULES)
def test_only_some_files_have_it(rule: str) -> None:
    places, pattern, allowed = RULES[rule]
    names = [name for name, text in sources(*places.split()).items() if re.search(pattern, text, re.MULTILINE)]
    found = {next((place for place in allowed.split() if name.startswith(place)), name) for name in names}
    assert found == set(allowed.split())


# Each room of the service, and what else of the service it knows.
ROOMS = {
    "storage": "",
    "jobs": "errors settings storage",
    "sandbox": "jobs logs pictures processes settings",
    "worker": "errors jobs logs processes sandbox settings storage",
    "api": "errors jobs keys logs opening pictures processes sandbox settings storage",
}


@pytest.mark.parametrize("room", ROOMS)
def test_what_each_room_of_the_service_knows(room: str) -> None:
    inside = f"service.{room}."
    known = {name for module, names in IMPORTS.items() if module.startswith(inside) for name in names}
    others = {name.split(".")[1] for name in known if name.startswith("service.")} - {room}
    assert others == {*ROOMS[room].split()}


def test_the_exported_names() -> None:
    """The names in docs/python.md have a test beside that page's examples (tests/torch/test_python_page.py)."""
    assert sgmethod.__all__ == sorted(sgmethod.__all__)
    assert all(getattr(sgmethod, name) is not None for name in [*sgmethod.__all__, "open"])
    assert not {*sgmethod.__all__} & {*dir(builtins)}  # which import * would replace
    assert sgmethod.__version__ == version("sgmethod")
    with pytest.raises(AttributeError, match="no attribute 'transmogrify'"):
        _ = sgmethod.transmogrify


DECODE = """
import sys
import sgmethod, sgmethod.cli.main, sgmethod.io.image, sgmethod.profiles
path = sys.argv[1]
assert sgmethod.cli.main.main(["decode", path, path + ".png", "--quiet"]) == 0
assert sgmethod.info(path).version == 1
pixels = sgmethod.decode(path)
sgmethod.set_threads(1)
print(pixels.shape, pixels.sum())
print(*sorted({name.split(".")[0] for name in sys.modules}))
"""


def test_decoding_imports_neither_torch_nor_the_encoders_libraries(tmp_path: Path) -> None:
    data = golden_path("v1-paper.sg").read_bytes()
    (tmp_path / "picture.sg").write_bytes(data)
    command = [sys.executable, "-c", DECODE, tmp_path / "picture.sg"]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60)
    result, imported = done.stdout.decode().splitlines()
    pixels = sgmethod.decode(data)
    assert pixels.any()
    assert result == f"{pixels.shape} {pixels.sum()}"
    assert {"sgmethod", "numpy"} <= set(imported.split())
    assert not {"torch", "cv2", "skimage", "scipy"} & set(imported.split())


ENCODE = """
import sys
import numpy as np
import sgmethod
pixels = np.random.default_rng(0).integers(0, 256, (24, 32, 4), np.uint8)
for picture, tune in ((pixels, "psnr"), (pixels[..., :3], "visual")):
    assert sgmethod.encode(picture, bytes=200, tune=tune, time_limit_s=20).stats.gaussians
print("torch" in sys.modules)
"""


def test_an_encode_by_profile_rd_imports_no_torch(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", ENCODE], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "False\n"
    by_command = [sys.executable, "-X", "importtime", "-m", "sgmethod", "encode", PHOTOGRAPHS / "kodim23-crop.png"]
    ran = subprocess.run([*by_command, tmp_path / "out.sg"], capture_output=True, text=True, check=True, timeout=60)
    imported = re.findall(r"^import time: .*\| +(\S+)$", ran.stderr, re.MULTILINE)
    assert "sgmethod.rd.encode" in imported
    assert not [name for name in imported if name.split(".")[0] == "torch"]
