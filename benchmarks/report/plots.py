"""Plots as SVG, readable without colour: lines differ by dashes and marks. The same data give the same SVG.

Narrow, with the legend below, so that two beside each other in the README have letters large enough to read.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import write_text

Draw = Callable[[Any], None]  # on the axes of matplotlib

WIDTH_IN, HEIGHT_IN, LINE_IN = 5.4, 3.2, 0.18  # of a panel; of a line of title or legend
LEGEND_COLUMNS = 2
COLOURS = ("#000000", "#0072b2", "#d55e00", "#009e73", "#b0508c")  # all dark enough to be read as grey
DASHES = ("-", "--", "-.", ":", (0, (9, 2, 1, 2, 1, 2)), (0, (1, 3)), (0, (8, 3)))
MARKS = "os^DvP*xh<>dX+p|"  # unlike colours and dashes, none repeats


def style(k: int) -> dict[str, Any]:
    """Colour, dashes and marks of the k-th line, the same in every panel."""
    return {"color": f"C{k % len(COLOURS)}", "linestyle": DASHES[k % len(DASHES)], "marker": MARKS[k % len(MARKS)]}


def save(panels: Sequence[Draw], title: str, of: str, path: Path) -> None:
    """Write path.svg: the panels one below the other, and one legend. of: a second line of the title."""
    try:
        import matplotlib as mpl
        from cycler import cycler
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SystemExit("plots need matplotlib: pip install -e '.[benchmark]'") from error
    settings = {"svg.hashsalt": path.name, "font.size": 9, "lines.markersize": 4, "lines.linewidth": 1.2}
    settings |= {"axes.grid": True, "axes.axisbelow": True, "grid.color": "0.9"}
    settings |= {"xtick.bottom": False, "ytick.left": False}  # the grid's lines are enough
    settings |= {"axes.prop_cycle": cycler(color=COLOURS)}
    with mpl.rc_context(settings | {"svg.fonttype": "none"}):
        figure = Figure(layout="constrained")
        all_axes = figure.subplots(len(panels), squeeze=False)[:, 0]
        named: dict[str, Any] = {}
        for draw, axes in zip(panels, all_axes, strict=True):
            draw(axes)
            axes.minorticks_off()
            for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
                named.setdefault(name, handle)
        all_axes[0].set_title(f"{title}\n{of}".strip(), loc="left", fontsize=9)
        if named:
            options = {"loc": "outside lower left", "ncols": LEGEND_COLUMNS, "handlelength": 4}
            figure.legend(named.values(), named.keys(), frameon=False, fontsize=8, **options)
        lines = 2 + math.ceil(len(named) / LEGEND_COLUMNS)
        figure.set_size_inches(WIDTH_IN, HEIGHT_IN * len(panels) + LINE_IN * lines)
        drawn = io.StringIO()
        figure.savefig(drawn, format="svg", metadata={"Date": None})
        one_group_a_line = re.sub(r"\s*\n(?!\s*<g id|$)\s*", " ", drawn.getvalue())
        write_text(path.with_suffix(".svg"), one_group_a_line)
