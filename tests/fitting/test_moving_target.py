"""Targets that move with the error of the fit (fitting/moving_target.py)."""

from __future__ import annotations

import numpy as np

from sgmethod.backend.planes import all_halved
from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.level import target_of
from sgmethod.fitting.moving_target import MAX_DETAIL, ExaggeratedTarget, led
from sgmethod.opencv import cv2


def grainy(height: int = 64, width: int = 96) -> Target:
    """Grain on the left, a plain ground on the right."""
    pixels = np.full((height, width, 3), 128, np.uint8)
    fine = np.random.default_rng(0).integers(64, 192, (height // 4, width // 8), np.uint8)
    pixels[:, : width // 2] = np.kron(fine, np.ones((4, 4), np.uint8))[..., None]
    return target_of(pixels)


def followed(original: Target, drawn: Target, times: int = 40) -> Target:
    moving = ExaggeratedTarget.from_target(original, hides=False)
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
    most = max(MAX_DETAIL)
    assert original.std() < now.std() < most * original.std()


def test_grain_that_is_hidden_is_not_exaggerated() -> None:
    original = grainy()
    missing = (original - np.full_like(original, round(original.mean(dtype=np.float64)))) / np.float32(TARGET_WHITE)
    grain = np.rint(missing * TARGET_WHITE).astype(np.int16)
    still = ExaggeratedTarget.from_target(original, hides=False)
    plain, hiding = (
        moving.moved(lambda first, end: all_halved(missing[:, first:end]))
        for moving in (still, still.without(grain.copy()))
    )
    assert (hiding.now + grain - original).std() < 0.8 * (plain.now - original).std()


def test_a_target_that_has_moved_often_is_the_picture_without_grain_and_with_the_last_detail() -> None:
    """It moves in place, so what one move adds the next has to take away."""
    original = grainy()
    grain = np.random.default_rng(1).integers(-200, 200, original.shape).astype(np.int16)
    moving = ExaggeratedTarget.from_target(original, hides=False).without(grain.copy())
    for drawn in (0.9, 0.5, 0.7):
        error = original * np.float32((1 - drawn) / TARGET_WHITE)
        moving = moving.moved(lambda first, end, error=error: all_halved(error[:, first:end]))
    assert moving.added is not None
    assert moving.added.any()
    assert (moving.now == original - grain + cv2.resize(moving.added, original.shape[:0:-1])).all()


def test_coarse_errors_lead_the_target_of_refining() -> None:
    """Twice an error of 0.1 that is the same everywhere, and nothing for one that alternates within a square."""
    original = grainy()
    even = np.full(original.shape, 0.1, np.float32)
    odd = even.copy()
    odd[:, :, ::2] *= -1
    for error, wanted in ((even, 0.2), (odd, 0.0)):
        moved = led(original, lambda first, end, error=error: all_halved(error[:, first:end]), 2.0, 2)
        assert np.abs((moved - original) / TARGET_WHITE - wanted).max() < 1e-3
