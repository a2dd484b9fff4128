"""What scenes take at one PSNR, and what each saving saves."""

from __future__ import annotations

from benchmarks.report.results import Row, rows
from benchmarks.tables import number, table

ORDER = ("one colour", "gradient", "sky", "text", "face", "facade", "foliage", "noise")
TEXTURED = "textured photograph"  # with which the other large scenes are compared


def by_scene() -> dict[str, dict[str, Row]]:
    """Rows by scene, and by the saving that was refused ("" for none)."""
    found: dict[str, dict[str, Row]] = {scene: {} for scene in ORDER}
    for row in rows("scenes"):
        found[row["scene"]][row["without"]] = row
    return found


def needs_table() -> str:
    """A line for each scene: what it takes."""
    lines = [
        [scene, f"{row['gaussians']:,}", f"{row['bytes']:,}", row["steps"], number(row["cpu_s"], ".2g")]
        for scene, row in ((scene, by_saving[""]) for scene, by_saving in by_scene().items())
    ]
    return table("scene | Gaussians | bytes | steps | seconds", lines)


def large_table() -> str:
    """A line for each large scene, a column for each budget and size: its time in units of the textured photograph's,
    its bytes and its PSNR."""
    found = {(row["scene"], row["max_bytes"], row["megapixels"]): row for row in rows("sparse")}
    columns = sorted({key[1:] for key in found})
    lines = []
    for scene in dict.fromkeys(scene for scene, *_ in found):
        cells = []
        for column in columns:
            row, textured = found[scene, *column], found[TEXTURED, *column]
            cells.append(f"{100 * row['cpu_s'] / textured['cpu_s']:.0f} %, {row['bytes']:,}, {row['psnr']:.1f} dB")
        lines.append([scene, *cells])
    titles = [f"{max_bytes:,} bytes, {megapixels:g} MP" for max_bytes, megapixels in columns]
    return table(" | ".join(["scene, at most", *titles]), lines)


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
    for row in rows("sparse"):
        mark = f"scenes.{row['scene'].replace(' ', '-')}-{row['megapixels']:g}mp-{row['max_bytes']}"
        found |= {f"{mark}-s": row["cpu_s"], f"{mark}-bytes": row["bytes"], f"{mark}-gaussians": row["gaussians"]}
    return found
