"""The target that runs ahead of what the eye sees (fitting/moving_target.py)."""

from __future__ import annotations

import numpy as np

from sgmethod.backend.planes import all_halved
from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.level import target_of
from sgmethod.fitting.moving_target import ExaggeratedTarget
from sgmethod.settings.rd import RD


def grainy(height: int = 64, width: int = 96) -> Target:
    """Grain on the left, a plain ground on the right."""
    pixels = np.full((height, width, 3), 128, np.uint8)
    fine = np.random.default_rng(0).integers(64, 192, (height // 4, width // 8), np.uint8)
    pixels[:, : width // 2] = np.kron(fine, np.ones((4, 4), np.uint8))[..., None]
    return target_of(pixels)


def followed(original: Target, drawn: Target, times: int = 40) -> Target:
    moving = ExaggeratedTarget.from_target(original, 4, RD.objective.moving)
    for _ in range(times):
        moving = moving.moved(
            lambda first, end: all_halved((original - drawn)[:, first:end] / np.float32(TARGET_WHITE))
        )
    return moving.now


def test_the_target_stays_where_the_picture_is_right() -> None:
    original = grainy()
    assert np.abs(followed(original, original) - original).max() <= 1


def test_detail_that_is_drawn_too_weak_is_asked_for_stronger() -> None:
    """Half as strong it has a similarity of 0.8; on the plain ground nothing is asked for."""
    original = grainy()
    mean = original.mean(dtype=np.float64)
    weak = np.rint(mean + (original - mean) / 2).astype(np.int16)
    now = followed(original, weak)
    grain = np.s_[:, 8:-8, 8:40]
    assert 1.1 < now[grain].std() / weak[grain].std() / 2 < 1.7
    assert np.abs((now - original)[:, :, 64:]).max() <= 0.02 * TARGET_WHITE


def test_detail_is_not_exaggerated_beyond_its_limit() -> None:
    original = grainy()
    flat = np.full_like(original, round(original.mean(dtype=np.float64)))
    now = followed(original, flat)
    # Of the coarse error, at most all is asked for once more.
    most = max(RD.objective.moving.max_detail) + 1
    assert original.std() < now.std() < most * original.std()


def test_grain_that_is_hidden_is_not_exaggerated() -> None:
    original = grainy()
    missing = (original - np.full_like(original, round(original.mean(dtype=np.float64)))) / np.float32(TARGET_WHITE)
    grain = np.rint(missing * TARGET_WHITE).astype(np.int16)
    still = ExaggeratedTarget.from_target(original, 4, RD.objective.moving)
    plain, hiding = (
        moving.moved(lambda first, end: all_halved(missing[:, first:end])) for moving in (still, still.without(grain))
    )
    assert (hiding.now + grain - original).std() < 0.8 * (plain.now - original).std()
