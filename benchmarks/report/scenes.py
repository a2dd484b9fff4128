"""What scenes take at one PSNR, and what each saving saves."""

from __future__ import annotations

from benchmarks.report.results import Row, rows
from benchmarks.tables import number, table

ORDER = ("one colour", "gradient", "sky", "text", "face", "facade", "foliage", "noise")
SPARSE = ("one dot", "one word", "one line", "stars")  # large, with a budget


def by_scene() -> dict[str, dict[str, Row]]:
    """Rows by scene, and by the saving that was refused ("" for none)."""
    found: dict[str, dict[str, Row]] = {scene: {} for scene in ORDER}
    for row in rows("scenes"):
        found[row["scene"]][row["without"]] = row
    return found


def sparse_rows() -> list[Row]:
    """Rows of the large scenes."""
    by_name = {row["scene"]: row for row in rows("sparse")}
    return [by_name[scene] for scene in SPARSE]


def needs_table() -> str:
    """A line for each scene: what it takes."""
    lines = [
        [scene, f"{row['gaussians']:,}", f"{row['bytes']:,}", row["steps"], number(row["cpu_s"], ".2g")]
        for scene, row in ((scene, by_saving[""]) for scene, by_saving in by_scene().items())
    ]
    return table("scene | Gaussians | bytes | steps | seconds", lines)


def sparse_table() -> str:
    """A line for each large scene."""
    lines = [
        [
            *(row["scene"], row["gaussians"], row["bytes"], number(row["psnr"], ".1f")),
            *(number(row["cpu_s"], ".2g"), number(row["mib"], ".0f")),
        ]
        for row in sparse_rows()
    ]
    return table("scene | Gaussians | bytes | PSNR | seconds | MiB", lines)


def savings_table() -> str:
    """A line for each saving, a column for each scene: bytes and seconds without it, as multiples."""
    scenes = by_scene()
    savings = [saving for saving in scenes[ORDER[0]] if saving]
    lines = [[saving, *(times(by_saving, saving) for by_saving in scenes.values())] for saving in savings]
    return table(" | ".join(["what is saved", *scenes]), lines)


def times(by_saving: dict[str, Row], saving: str) -> str:
    """Bytes and seconds of a scene without a saving, as multiples of those with it."""
    usual, without = by_saving[""], by_saving[saving]
    if usual["gaussians"] == 0 and without["steps"] == 0:
        return ""  # nothing is fitted, and the saving has nothing to save
    return f"{without['bytes'] / usual['bytes']:.2f}, {without['cpu_s'] / usual['cpu_s']:.2f}"


def figures() -> dict[str, float]:
    """The figures of sentences, by mark."""
    found: dict[str, float] = {}
    for scene, by_saving in by_scene().items():
        name = f"scenes.{scene.replace(' ', '-')}"
        found |= {f"{name}-{figure}": by_saving[""][figure] for figure in ("gaussians", "bytes")}
        found[f"{name}-ms"] = 1000 * by_saving[""]["cpu_s"]
    found["scenes.sparse-most-s"] = max(row["cpu_s"] for row in sparse_rows())
    return found
