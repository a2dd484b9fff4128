"""Plots as SVG and PNG, readable without colour: lines differ by dashes and marks. The same data give the same SVG."""

from __future__ import annotations

from pathlib import Path

from benchmarks.report.section import Draw

SIZE_IN = (7.2, 4.4)
GREYS = ("0", "0.35", "0.55")


def save(draw: Draw, title: str, path: Path) -> None:
    """Write path.svg and path.png."""
    try:
        import matplotlib as mpl
        from cycler import cycler
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SystemExit("plots need matplotlib: pip install '.[plot]'") from error
    style = {"svg.hashsalt": path.name, "font.size": 9, "lines.markersize": 4, "lines.linewidth": 1.2}
    style |= {"axes.prop_cycle": cycler(color=GREYS), "axes.grid": True, "grid.color": "0.9", "svg.fonttype": "none"}
    with mpl.rc_context(style):
        figure = Figure(figsize=SIZE_IN, layout="constrained")
        axes = figure.add_subplot()
        draw(axes)
        axes.set_title(title)
        if axes.get_legend_handles_labels()[0]:
            figure.legend(loc="outside right upper", frameon=False, fontsize=8, handlelength=4)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path.with_suffix(".svg"), metadata={"Date": None})
        figure.savefig(path.with_suffix(".png"), dpi=110)
