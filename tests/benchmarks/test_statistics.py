"""The statistics of the published tables, on figures that are worked out by hand."""

from __future__ import annotations

import re
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.ablation.report import complete, worth
from benchmarks.bd import compared, curves
from benchmarks.machine import kept_rows, one_a_line, origin
from benchmarks.pictures import Pixels
from benchmarks.rd.baselines import Baseline
from benchmarks.rd.equal import between, difference
from benchmarks.rd.report import AVIF, Row, against, bd_psnr, bd_rate, bd_rates, means
from benchmarks.report.paper import at_rate, marked
from benchmarks.report.previews import times_our_bytes
from benchmarks.report.rate import value_at
from benchmarks.tables import standard_error

ANCHOR = [(0.1, 26.0), (0.2, 29.0), (0.4, 32.0), (0.8, 34.0)]


def rows(codec: str, image: str, points: list[tuple[float, float]], max_bpp: float | None = None) -> list[Row]:
    return [Row(codec, max_bpp or bpp, image, 0, bpp, db, None, None, None, None) for bpp, db in points]


def test_differences_in_rate_and_quality() -> None:
    half = [(bpp / 2, db) for bpp, db in ANCHOR]
    assert bd_rate(ANCHOR, half) == pytest.approx(-50)
    assert bd_rate(half, ANCHOR) == pytest.approx(100)
    assert bd_rate(ANCHOR, ANCHOR) == pytest.approx(0)
    assert bd_psnr(ANCHOR, [(bpp, db + 1.5) for bpp, db in ANCHOR]) == pytest.approx(1.5)
    assert bd_rate(ANCHOR, [*half[:2], (0.15, 31.0)]) is not None  # over what both reach
    for none in ([(0.1, 26.0)], [(0.1, 10.0), (0.2, 20.0)], [(0.1, 26.0), (0.2, 25.0)]):
        assert bd_rate(ANCHOR, none) is None  # one point; no quality in common; a curve that falls


def test_a_rate_is_the_mean_over_pictures() -> None:
    third = [(bpp / 4, db) for bpp, db in ANCHOR]
    both = rows("old", "a", ANCHOR) + rows("old", "b", ANCHOR) + rows("new", "a", ANCHOR) + rows("new", "b", third)
    rate = against(both, "new", "old")
    assert rate is not None
    assert (rate.mean, rate.least, rate.most, rate.standard_error) == pytest.approx((-37.5, -75, 0, 37.5))
    assert (rate.from_bpp, rate.to_bpp) == pytest.approx(((0.1 + 0.025) / 2, 0.8))  # of the new one, and of the old one
    only_a = against(both[:-4], "new", "old")  # of the pictures that both have
    assert only_a is not None
    assert (only_a.mean, only_a.standard_error) == (pytest.approx(0), None)
    assert [(rate["codec"], rate["pictures"]) for rate in bd_rates([*both, *rows(AVIF[0], "a", ANCHOR)])] == [
        ("old", 1),
        ("new", 1),
    ]
    assert against(both[:-3], "new", "old") is None  # one has no curve: no mean hides that


def test_errors_of_pictures_that_are_alike() -> None:
    """Twice the same picture is no second sample: its group counts once."""
    assert standard_error([1.0, 2.0, 6.0]) == pytest.approx(statistics.stdev([1, 2, 6]) / 3**0.5)
    assert standard_error([1.0, 3.0, 1.0, 3.0], "abab") == pytest.approx(standard_error([1.0, 3.0]))
    assert standard_error([1.0, 3.0], "aa") is standard_error([1.0]) is None
    third = [(bpp / 4, db) for bpp, db in ANCHOR]
    alike = ("broken_pcb.png", "lying_dog.png")  # of one package
    both = [row for image in alike for row in rows("old", image, ANCHOR)] + rows("new", alike[0], ANCHOR)
    rate = against([*both, *rows("new", alike[1], third)], "new", "old")
    assert rate is not None and rate.standard_error is None


def test_values_between_sizes() -> None:
    average = means(rows("ours", "a", [(0.2, 30.0)], 0.25) + rows("theirs", "a", [(0.1, 26.0), (0.4, 30.0)]))
    assert value_at(average, "theirs", "ours", "psnr") == pytest.approx(28.0)  # 0.2 is half way between 0.1 and 0.4
    average = means(rows("ours", "a", [(0.5, 30.0)], 0.25) + rows("theirs", "a", [(0.1, 26.0), (0.4, 30.0)]))
    assert value_at(average, "theirs", "ours", "psnr") is None


def test_a_curve_of_jpeg_ends_soon_after_its_last_file() -> None:
    points = [(0.1, 24.0), (0.4, 28.0)]
    assert at_rate(points, 0.2) == pytest.approx(26.0)  # half way between 0.1 and 0.4
    assert at_rate(points, 0.4 * 2**0.1) == pytest.approx(28.2)
    assert at_rate(points, 0.09) is at_rate(points, 0.5) is None


def test_a_fit_far_below_its_other_seeds_came_apart() -> None:
    assert marked([47.1, 38.1, 46.8]) == [(47.1, False), (38.1, True), (46.8, False)]
    assert not any(apart for _, apart in marked([46.5, 44.2, 43.6]))


def test_differences_at_equal_bytes() -> None:
    """By hand. Pictures of one package are one cluster, and files above the rate are not compared."""
    small, large = (replace(rows("avif", "a", [point])[0], max_bpp=0.2) for point in ((0.1, 26.0), (0.4, 30.0)))
    assert (between(small, large).bpp, between(small, large).psnr) == (0.2, pytest.approx(28))  # half way, in log bytes
    names = ["oled_display", "led_matrix", "broken_pcb", "lying_dog", "too_large"]
    gains = [1.0, 2.0, 3.0, 6.0, 99.0]
    measured = [row for name in names for row in rows("avif", name, [(0.2 if name != "too_large" else 0.3, 30.0)], 0.2)]
    measured += [row for name, gain in zip(names, gains, strict=True) for row in rows("rd", name, [(0.2, 30 + gain)])]
    found = difference(measured, "rd", "avif", 0.2, "psnr")
    assert found is not None
    assert (found.pictures, found.gain, found.better) == (4, pytest.approx(3), 4)
    # The last two come from one package: sums of -2, -1 and 3, times 3 / 2, over the square of 4.
    assert found.standard_error == pytest.approx((1.5 * (4 + 1 + 9)) ** 0.5 / 4)
    assert standard_error(gains[:4]) == pytest.approx(statistics.stdev(gains[:4]) / 2)


def test_files_around_a_rate() -> None:
    class Doubling(Baseline):
        name, qualities = "doubling", range(4)

        def encode(self, pixels: Pixels, quality: float) -> bytes:
            return bytes(10 * 2 ** int(quality))

    codec, pixels = Doubling(), np.zeros((8, 10, 3), np.uint8)  # 10 bytes for each bit per pixel
    found = {aim: [len(file.data) for file in codec.around(pixels, aim)] for aim in (0.9, 1, 3, 8, 9)}
    assert found == {0.9: [10], 1: [10, 20], 3: [20, 40], 8: [80], 9: [80]}  # alone where there is no other
    assert [len(file.data) for file in codec.around(pixels[:4], 3)] == [10, 20]  # nothing is kept of another picture


def test_bytes_of_previews() -> None:
    def row(codec: str, most: int, size: int, db: float) -> dict[str, Any]:
        return {"codec": codec, "max_bytes": most, "bytes": size, "psnr": db, "image": "a"}

    webp = [row("WebP", 200, 200, 20.0), row("WebP", 800, 800, 24.0)]
    avif = [row("AVIF", 400, 400, 20.0), row("AVIF", 900, 900, 25.0)]
    assert times_our_bytes([row("sgmethod", 200, 200, 22.0), *webp, *avif], 200) == pytest.approx(2)  # 400 of WebP
    assert times_our_bytes([row("sgmethod", 200, 200, 30.0), *webp, *avif], 200) is None  # none is as good


def test_gains_over_pictures() -> None:
    """The mean over pictures of the mean over seeds; a picture without every seed does not count."""
    gains = {("a", 0): -1.0, ("a", 1): -2.0, ("b", 0): -3.0, ("b", 1): -4.0}
    files = [
        {
            "setting": setting,
            "image": image,
            "seed": seed,
            "bpp": bpp,
            "psnr": db + (more if setting == "new" else 0),
        }
        for (image, seed), more in {**gains, ("c", 0): 50.0}.items()
        for setting in ("old", "new")
        for bpp, db in ANCHOR
    ]
    found = complete(files)
    assert worth(found, "new", "old", bd_psnr) == pytest.approx((-2.5, 1.0))
    rate, error = worth(found, "old", "new", bd_rate)
    assert rate is not None and error is not None
    assert rate < 0 < error


def test_a_run_goes_on_with_its_own_rows_alone(tmp_path: Path) -> None:
    path, rows = tmp_path / "run.json", [{"psnr": 1}]
    where: dict[str, Any] = {
        **origin(),
        "commit": "a" * 12,
        "settings": {"bpp": 1},
        "command": "python -m benchmarks.rd",
    }
    path.write_text(one_a_line({**where, "rows": rows}))
    assert kept_rows(path, where) == rows
    machine: Any = where["machine"]
    for other in (
        {"commit": "b" * 12},
        {"settings": {"bpp": 2}},
        {"machine": {**machine, "cores": 64}},
        {"command": "SG_THREADS=1 python -m benchmarks.rd"},
    ):
        assert kept_rows(path, {**where, **other}) == []
    assert kept_rows(tmp_path / "none.json", where) == []


def test_bd_rates_of_two_tables(tmp_path: Path) -> None:
    """The example of the package bjontegaard 1.3.0, by its "pchip", which agrees with the JCT-VC's spreadsheet."""
    anchor = [(9487.76, 40.037), (4593.60, 38.615), (2486.44, 36.845), (1358.24, 34.851)]
    test = [(9787.80, 40.121), (4469.00, 38.651), (2451.52, 36.970), (1356.24, 34.987)]
    lines = {"anchor": [("old", "a", *point) for point in anchor]}
    lines["test"] = [("new", "a", *point) for point in test] + [("new", "b", *point) for point in test]
    for name, of in lines.items():
        text = "".join(f"{codec},{picture},{size},{db},us\n" for codec, picture, size, db in of)
        (tmp_path / f"{name}.csv").write_text("codec,picture,bytes,psnr,source\n" + text)
    found = compared(*(curves(tmp_path / f"{name}.csv", "psnr") for name in lines))
    assert re.search(r"\| new \| old \| 1 of 1 \| (\S+) ", found)[1] == "-4.42"  # type: ignore[index]
    with pytest.raises(SystemExit, match="no column 'ssimulacra2'"):
        curves(tmp_path / "test.csv", "ssimulacra2")
