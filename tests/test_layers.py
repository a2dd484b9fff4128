"""Data flows one way: modules import only from those above them in the list that sgmethod/__init__.py opens with."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import sgmethod

PACKAGE = Path(sgmethod.__file__).parent
FACADE = {"__init__", "__main__"}  # the package's face and its command: they import what they hand on

EXPORTED = {
    *("BitstreamError", "Budget", "BudgetError", "Encoded", "ImageError", "NativeModuleError", "SgError", "Stats"),
    *("TracePoint", "View", "ViewError", "decode", "encode", "info", "set_threads"),
}


def listed() -> dict[str, int]:
    """Names and the lines they stand on in the package's text: modules, and packages without their slash."""
    lines = re.findall(r"^    (\S+(?:, \S+)*)  +\S", sgmethod.__doc__ or "", re.MULTILINE)
    return {name.rstrip("/"): line for line, names in enumerate(lines) for name in names.split(", ")}


def layer(module: str) -> str:
    """The entry of the list that a module belongs to; the compiled module is native/."""
    name = module.split(".")[1]
    return "native" if name == "_native" else name


def modules() -> dict[str, Path]:
    """Files of the package by dotted name, without the façade."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if parts[-1] not in FACADE:
            found[".".join(parts)] = path
    return found


def imports_of(path: Path, known: set[str]) -> set[str]:
    """Modules of this package imported anywhere in a file: at its top, in functions, for types."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno} imports relatively"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else node.module or "" for name in inner}
    return {name for name in found if name.split(".")[0] == "sgmethod"}


IMPORTS = {
    name: imports_of(path, {*modules(), "sgmethod._native"}) for name, path in modules().items()
}  # by importing module


def test_every_module_is_listed_and_exists() -> None:
    assert set(listed()) == {layer(name) for name in IMPORTS} | {"native"}


@pytest.mark.parametrize("module", IMPORTS)
def test_imports_come_from_above(module: str) -> None:
    """Modules on one line, and those of one package, may import each other."""
    lines = listed()
    for other in IMPORTS[module]:
        assert other != "sgmethod", f"{module} imports the package's face instead of a module"
        assert lines[layer(other)] <= lines[layer(module)], f"{module} imports {other}"


def test_modules_of_one_layer_do_not_import_in_a_circle() -> None:
    order = list(TopologicalSorter(IMPORTS).static_order())  # raises CycleError
    assert set(IMPORTS) <= set(order)


def test_the_imports_are_found() -> None:
    assert "sgmethod.errors" in IMPORTS["sgmethod.decode"]
    assert "sgmethod._native" in IMPORTS["sgmethod.native_module"]
    assert "sgmethod.bitstream" in IMPORTS["sgmethod.codec"]  # from sgmethod import bitstream
    assert "sgmethod.quantise.lattice" in IMPORTS["sgmethod.quantise.paper"]
    assert "sgmethod.codec" in IMPORTS["sgmethod.cli"]  # within a function


def test_the_exported_names() -> None:
    assert sgmethod.__all__ == sorted(EXPORTED)
    for name in sgmethod.__all__:
        assert getattr(sgmethod, name) is not None
    own = {
        name
        for name, value in vars(sgmethod).items()
        if not name.startswith("_") and getattr(value, "__module__", "").startswith("sgmethod")
    }
    assert {name for name in own if not isinstance(getattr(sgmethod, name), ModuleType)} <= EXPORTED
    with pytest.raises(AttributeError, match="no attribute 'transmogrify'"):
        _ = sgmethod.transmogrify


DECODE = """
import sys
import sgmethod, sgmethod.cli, sgmethod.image, sgmethod.profiles
pixels = sgmethod.decode(sys.stdin.buffer.read())
sgmethod.set_threads(1)
print(pixels.shape, pixels.sum())
print(*sorted({name.split(".")[0] for name in sys.modules}))
"""


def test_decoding_imports_neither_torch_nor_the_encoders_libraries() -> None:
    data = (Path(__file__).parent / "data" / "v1-paper.sg").read_bytes()
    done = subprocess.run([sys.executable, "-c", DECODE], input=data, capture_output=True, check=True, timeout=60)
    result, imported = done.stdout.decode().splitlines()
    pixels = sgmethod.decode(data)
    assert pixels.any()
    assert result == f"{pixels.shape} {pixels.sum()}"
    assert {"sgmethod", "numpy"} <= set(imported.split())
    assert not {"torch", "cv2", "skimage", "scipy"} & set(imported.split())
