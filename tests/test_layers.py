"""Data flows one way: a room imports only from those above it in the list that its package's text opens with."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

import service
import sgmethod
from tests.harness.data import PHOTOGRAPHS, ROOT, golden_path

FACES = {"sgmethod": sgmethod.__doc__ or "", "service": service.__doc__ or ""}
OUTSIDE = {"__init__", "__main__"}  # a package's face and its command: they import what they hand on

ENCODER = (
    r"sgmethod\.(codec|rd|paper|fitting|start|previews)\b|from sgmethod import .*\b(codec|encode|preview)\b"
    r"|(import|from) torch"
)

EXPORTED = {
    *(
        "BitstreamError",
        "Budget",
        "BudgetError",
        "Encoded",
        "Gaussians",
        "GaussiansError",
        "ImageError",
        "ImageWarning",
    ),
    *("Info", "MissingPackageError", "NativeModuleError"),
    *("ServerError", "SgError", "SgFile", "Stats", "TracePoint", "View", "ViewError"),
    *("Row", "Tally", "decode", "encode", "encode_many", "info", "open", "pack", "set_threads"),
    *("read_npz", "read_ply", "write_npz", "write_ply"),
    *("Preview", "from_text", "preview", "to_text"),
}


def listed(package: str) -> list[str]:
    """The rooms and modules of a package, as its text lists them; rooms end in a slash."""
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


def room(module: str) -> str:
    """The entry of the list that a module belongs to: the deepest room that holds it."""
    package, *parts = module.split(".")
    path = "/".join(parts) + "/"
    rooms = [entry for entry in listed(package) if path.startswith(entry if entry.endswith("/") else entry + "/")]
    return max(rooms, key=len, default="")


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
def test_every_room_is_listed_and_exists(package: str) -> None:
    found = {room(name) for name in MODULES if name.startswith(package + ".")}
    assert "" not in found
    assert set(listed(package)) == found


def test_imports_come_from_above() -> None:
    """Modules of one room may import each other, but nobody a package's face instead of a module."""
    order = {name: [*listed(name)].index for name in FACES}
    wrong = [
        f"{module} imports {other}"
        for module, imports in IMPORTS.items()
        for place in [order[module.split(".")[0]]]
        for other in imports
        if other in FACES or place(room(other)) > place(room(module))
    ]
    assert wrong == []


def test_modules_do_not_import_in_a_circle() -> None:
    order = list(TopologicalSorter(IMPORTS).static_order())  # raises CycleError
    assert set(IMPORTS) <= set(order)


def test_native_rooms_include_from_above() -> None:
    """In the order in which the native package's text names them."""
    native = ROOT / "sgmethod" / "native"
    order = re.findall(r"(\w+)/", (ast.get_docstring(ast.parse((native / "__init__.py").read_text())) or ""))
    sources = [path for path in native.rglob("*.*") if path.suffix in (".h", ".cpp")]
    assert set(order) == {path.parent.name for path in sources}
    included = 0
    for path in sources:
        for name in re.findall(r'^#include "(\w+)/', path.read_text(), re.MULTILINE):
            assert order.index(name) <= order.index(path.parent.name), (
                f"{path.parent.name}/{path.name} includes {name}/"
            )
            included += 1
    assert included > 50


def test_the_imports_are_found() -> None:
    assert "sgmethod.errors" in IMPORTS["sgmethod.decoder"]
    assert "sgmethod.native._native" in IMPORTS["sgmethod.native"]
    assert "sgmethod.bitstream.container" in IMPORTS["sgmethod.decoder"]  # from sgmethod.bitstream import container
    assert "sgmethod.paper.lattice" in IMPORTS["sgmethod.paper.tuning"]
    assert "sgmethod.codec" in IMPORTS["sgmethod.cli.encoding"]  # within a function
    assert "service.web.guards.problems" in IMPORTS["service.web.routes.jobs"]
    assert room("service.web.guards.problems") == "web/guards/"
    assert room("service.web.app") == "web/"


def test_the_service_leaves_the_encoder_to_confined_processes() -> None:
    importing = {name for name, path in modules("service").items() if re.search(ENCODER, path.read_text())}
    assert importing == {"service.sandbox.tasks"}


def test_the_reference_is_for_tests() -> None:
    """It brings torch, and is slow."""
    assert [name for name, imports in IMPORTS.items() if "sgmethod.backend.reference" in imports] == []


def in_rooms(*rooms: str) -> dict[str, ast.Module]:
    """Modules of these rooms by name, parsed."""
    names = [name for name in MODULES if name.split(".")[0] == "sgmethod" and room(name) in rooms]
    assert {room(name) for name in names} == set(rooms)
    return {name: ast.parse(MODULES[name].read_text()) for name in names}


def test_the_encoder_computes_through_its_backend() -> None:
    for name in in_rooms("rd/", "fitting/", "paper/"):
        assert not [other for other in IMPORTS[name] if other.startswith("sgmethod.native")], name


def test_only_profile_paper_imports_torch() -> None:
    names = [*in_rooms("rd/", "fitting/", "codec"), "sgmethod.backend.protocol", "sgmethod.backend.kernels"]
    imports_torch = re.compile(r"^\s*(import|from) torch\b", re.MULTILINE)
    assert [name for name in names if imports_torch.search(MODULES[name].read_text())] == []


def asks_for_tuning(node: ast.AST) -> bool:
    """Whether a name, an argument or a string speaks of how a file is tuned."""
    called = (getattr(node, field, None) for field in ("id", "arg", "attr"))
    return "tune" in called or (isinstance(node, ast.Constant) and node.value == "visual")


def test_few_know_how_a_file_is_tuned() -> None:
    trees = in_rooms("rd/", "fitting/", "paper/", "codec")
    asking = {name for name, tree in trees.items() if any(map(asks_for_tuning, ast.walk(tree)))}
    assert asking == {"sgmethod.codec", "sgmethod.fitting.objective"}


def test_dataclasses_are_frozen() -> None:
    """So a step changes nothing that another owns."""
    made = {
        f"{name}.{node.name}": ast.unparse(mark)
        for name, tree in in_rooms("rd/", "fitting/", "settings/").items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for mark in node.decorator_list
        if "dataclass" in ast.unparse(mark)
    }
    assert len(made) > 10
    assert [name for name, mark in made.items() if not re.search(r"\bfrozen=True\b", mark)] == []


def test_no_test_imports_a_benchmark() -> None:
    for path in sorted((ROOT / "tests").rglob("*.py")):
        assert re.search(r"^\s*(from|import) benchmarks", path.read_text(), re.MULTILINE) is None, path


def test_the_harness_imports_no_test() -> None:
    for path in sorted((ROOT / "tests" / "harness").rglob("*.py")):
        assert re.search(r"^\s*(from|import) tests\.(?!harness)", path.read_text(), re.MULTILINE) is None, path


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
    assert sgmethod.__version__ == version("sgmethod")
    with pytest.raises(AttributeError, match="no attribute 'transmogrify'"):
        _ = sgmethod.transmogrify


DECODE = """
import sys
import sgmethod, sgmethod.cli.main, sgmethod.io.image, sgmethod.profiles
pixels = sgmethod.decode(sys.stdin.buffer.read())
sgmethod.set_threads(1)
print(pixels.shape, pixels.sum())
print(*sorted({name.split(".")[0] for name in sys.modules}))
"""


def test_decoding_imports_neither_torch_nor_the_encoders_libraries() -> None:
    data = golden_path("v1-paper.sg").read_bytes()
    done = subprocess.run([sys.executable, "-c", DECODE], input=data, capture_output=True, check=True, timeout=60)
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
