"""Damaged and hostile files (tests/bitstream/mutations.py), and files of which nothing but the size is right."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from sgmethod.view import View
from tests.bitstream.mutations import NEEDLES, explore, outcome
from tests.support.data import SIGNATURE, with_checksum


@pytest.mark.parametrize("count", [300, pytest.param(12_000, marks=pytest.mark.thorough)])
def test_any_damage(count: int, tmp_path: Path) -> None:
    seen = explore(count, 1, tmp_path / "damaged.sg")
    assert seen["drawn"] > count / 50
    assert seen["other"] > count / 5
    assert count < 10_000 or min(seen["limit"], seen["overlap"], seen["than the data"]) > 0


@given(st.integers(0, 255), st.integers(0, 8), st.integers(0, 8), st.binary(max_size=400), st.sampled_from([1.0, 0.5]))
def test_any_file(first: int, wide: int, high: int, rest: bytes, prefix: float) -> None:
    """Any flags, and sizes that can be drawn."""
    begin = first << 16 | (wide & 14) << 15 | high << 9
    outcome(with_checksum(SIGNATURE + begin.to_bytes(3, "big") + rest + bytes(4)), View(prefix=prefix))


def test_needles_overlap_in_a_pyramid_too() -> None:
    assert outcome(NEEDLES, View()) == "drawn"
    assert outcome(NEEDLES, View(3.0)) == "overlap"
