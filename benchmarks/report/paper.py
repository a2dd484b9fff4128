"""The paper's figure: PSNR by the number of Gaussians, before coding."""

from __future__ import annotations

from typing import Any

from benchmarks.report.plots import style
from benchmarks.report.results import rows
from benchmarks.tables import mean, standard_error

STARTS = {"random": "random", "fixed": "structure-guided, 6:2:1", "dynamic": "structure-guided, dynamic ratio"}


def gains() -> dict[str, dict[int, list[float]]]:
    """By start and number of Gaussians: the PSNR of each picture, above that of a random start."""
    by_fit = {(row["setting"], row["asked"], row["image"]): row["psnr"] for row in rows("gains/numbers")}
    found: dict[str, dict[int, list[float]]] = {start: {} for start in STARTS}
    for (start, asked, image), psnr in sorted(by_fit.items()):
        if ("random", asked, image) in by_fit:
            found[start].setdefault(asked, []).append(psnr - by_fit["random", asked, image])
    for asked in found["dynamic"].keys() - found["fixed"].keys():
        found["fixed"][asked] = found["dynamic"][asked]  # the dynamic ratio begins as the fixed one
    return found


def draw(axes: Any) -> None:
    """Gain over a random start against the number of Gaussians, with standard errors."""
    for k, (start, by_number) in enumerate(gains().items()):
        numbers = sorted(by_number)
        means, errors = ([figure(by_number[n]) for n in numbers] for figure in (mean, standard_error))
        axes.errorbar(numbers, means, errors, capsize=2, **style(k) | {"label": STARTS[start]})
    axes.set(xlabel="Gaussians, of a picture of 768x512 pixels", ylabel="dB above a random start")
