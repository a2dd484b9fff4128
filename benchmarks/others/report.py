"""Methods of others, as they were fitted here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks.published import quoted_values
from benchmarks.tables import MISSING, in_all, mean, number, table

NAMES = {"paper": "the paper", "ingp": "I-NGP", "neurbf": "NeuRBF", "2dgs": "2DGS", "3dgs": "3D-GS, flattened"}
NAMES |= {"rd": "profile `rd`"}
QUOTED = "representation, Kodak, 70,000 Gaussians"
TABLES = {"representation": "numbers", "compression": "bytes"}
FORMS = {"steps": ",.0f", "seconds": ".1f", "psnr": ".2f", "ms_ssim": ".4f"}


def summary(content: dict[str, Any]) -> Iterator[str]:
    """A table of fits in floating point, and one of files: means over the pictures that every method has."""
    quoted, settings = quoted_values(QUOTED, "psnr"), content["settings"]
    width, height = settings["sides"]
    for name, size in TABLES.items():
        rows = in_all([row for row in content["rows"] if row["table"] == name], "method")
        lines = []
        for method in dict.fromkeys(row["method"] for row in rows):
            own = [row for row in rows if row["method"] == method]
            cells = [
                number(mean([row.get(figure) for row in own]), form)
                for figure, form in ({size: ",.0f"} | FORMS).items()
            ]
            theirs = number(quoted.get(NAMES[method]), ".2f") if name == "representation" else MISSING
            lines.append([NAMES[method], *cells, theirs])
        if lines:
            titles = ["method", size, "steps", "seconds of the processor", "PSNR", "MS-SSIM", "PSNR quoted"]
            told = [k for k in range(len(titles)) if any(line[k] != MISSING for line in lines)]
            of = (
                f"{len({row['image'] for row in rows})} pictures of {width}x{height} pixels; fits of "
                f"{settings['seconds']:g} s on one core, in plain torch but for those by our kernels"
            )
            of += "; quoted: whole pictures, minutes on a GPU" if name == "representation" else ""
            shown = table(" | ".join(titles[k] for k in told), [[line[k] for k in told] for line in lines])
            yield f"Methods of others, {name} ({of}):\n\n{shown}"
