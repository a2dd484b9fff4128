"""Checks of robustness: of order, on rows by hand, and that bad starts reach the fit."""

from __future__ import annotations

import pytest

from benchmarks.robustness.fits import PLACED_BY
from benchmarks.robustness.order import EFFORT, SIZE, Row, checks, judged, spread
from sgmethod.paper.placement import place_by_structure
from sgmethod.profiles import Tune
from sgmethod.rd.densify import place


def row(figure: float, *, bpp: float = 0.25, effort: int = 5, mirror: int = 0, tune: Tune = "psnr") -> Row:
    return Row("fog", tune, bpp, effort, mirror, round(1000 * bpp), figure)


def test_each_row_is_held_against_the_best_with_less_time_or_fewer_bytes() -> None:
    rows = [row(30.0, effort=1), row(32.0, effort=2), row(31.5, effort=3), row(31.95, effort=5)]
    rows += [row(31.0, bpp=0.5), row(35.0, bpp=1), row(9.0, bpp=0.5, tune="visual"), row(9.0, mirror=1)]
    longer = {check.row.effort: (round(check.worse_by, 2), check.failed) for check in checks(rows, EFFORT)}
    assert longer == {2: (0, False), 3: (0.5, True), 5: (0.05, False)}
    larger = {check.row.bpp: (round(check.worse_by, 2), check.failed) for check in checks(rows, SIZE)}
    assert larger == {0.5: (0.95, True), 1: (0, False)}
    assert [line[2:4] for line in judged(rows)] == [[3, 1], [2, 1]]


def test_spread_is_over_mirror_images_alone() -> None:
    rows = [row(30.0), row(31.0, mirror=1), row(40.0, bpp=1), row(40.2, bpp=1, mirror=1), row(99.0, effort=9)]
    assert spread(rows, "psnr") == pytest.approx(((0.5 + 0.02) / 2) ** 0.5)
    assert spread(rows, "visual") == 0


def test_bad_starts_spoil_what_each_profile_calls() -> None:
    """Under its former name they spoiled nothing, and the failures were counted as the encoder's."""
    assert [vars(module)[name] for module, name in PLACED_BY.values()] == [place, place_by_structure]
