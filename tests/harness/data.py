"""The tests' own pictures and files, wherever a test stands."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]  # of the repository
DATA = ROOT / "tests" / "data"
PHOTOGRAPHS = DATA / "photographs"


def golden(version: int) -> dict[str, bytes]:
    """The golden files of one version of the format by name, such as "v3-color"."""
    return {f"v{version}-{path.stem}": path.read_bytes() for path in sorted((DATA / f"v{version}").glob("*.sg"))}


def golden_path(name: str) -> Path:
    """Where a golden file lies, or the picture of one: "v3-color.sg", "v1-paper.png"."""
    version, _, rest = name.partition("-")
    return DATA / version / rest
