"""Alpha, a separate grey picture in the file: encode alpha first, then the colours that it leaves visible.

Over any background, an error e of a colour under alpha a becomes an error a e of the picture. Its square therefore
counts a^2 times, and hidden pixels cost nothing. An error d of alpha becomes an error d (colour - background). The
error of a file is the mean of its errors over white and over black.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Backend
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw_whole
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.compositing import on_backgrounds
from sgmethod.metrics import psnr
from sgmethod.opencv import cv2
from sgmethod.rd import encode as pipeline
from sgmethod.rd.encode import KERNELS
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import RateControl
from sgmethod.scene import Pixels
from sgmethod.settings.rd import RdSettings

Plane = NDArray[np.float32]
TRIES = 4  # for a budget in dB
TIME = 0.3  # of a time limit


def encode(
    problem: Problem,
    alpha: Pixels,
    settings: RdSettings,
    rate: RateControl,
    session: Session,
    backend: Backend = KERNELS,
) -> tuple[StreamV2, int]:
    """Encode a picture with alpha [H, W]; return the coded picture and the optimiser steps it took."""
    pixels = inpainted(problem.pixels, alpha)
    source = np.dstack([pixels, alpha])
    layer, error, steps = _alpha(source, problem.is_short, settings, rate, session, backend)
    colours = replace(problem, objective=problem.objective.under(pixels, draw_whole(layer)[..., 0]))
    colour_rate, found = rate.beside_alpha(layer, error), list[tuple[float, StreamV2]]()
    for _ in session.deadline.attempts(TRIES):
        attempt = replace(session, deadline=session.deadline.at(1.0))
        stream, taken = pipeline.encode(colours, settings, colour_rate, attempt, backend)
        steps += taken
        stream = replace(stream, alpha=layer)
        missing = rate.missing_db(stream, source)
        found.append((missing, stream))
        if missing == 0:
            break
        # The colours' own error is not all of it: both layers are rounded and clamped.
        colour_rate = colour_rate.with_higher_target(missing)
    return min(found, key=lambda one: one[0])[1], steps


def _alpha(
    source: Pixels, is_short: bool, settings: RdSettings, rate: RateControl, session: Session, backend: Backend
) -> tuple[StreamV2, float, int]:
    """Encode the alpha plane of pixels [H, W, 4]; return it, the error of a file with exact colours, and the steps."""
    alpha_rate, steps = rate.for_alpha(), 0
    deadline, recorder = session.deadline.at(TIME), Recorder(session.recorder.clock)
    plane = Problem(Objective.from_alpha(source[..., 3]), is_short, with_shear=True)
    once = replace(settings, effort=replace(settings.effort, rounds=(0,)))
    for _ in deadline.attempts(TRIES):
        attempt = replace(session, deadline=deadline.at(1.0), recorder=recorder)
        layer, taken = pipeline.encode(plane, once, alpha_rate, attempt, backend)
        steps += taken
        error = _error(np.dstack([source[..., :3], draw_whole(layer)[..., 0]]), source)
        if rate.allows_alpha(error):
            break
        alpha_rate = replace(alpha_rate, quantum=alpha_rate.quantum / 2)
    return layer, error, steps


def _error(decoded: Pixels, source: Pixels) -> float:
    """Mean squared error of decoded pixels [H, W, 4], 1 being white."""
    return float(10 ** (-psnr(on_backgrounds(decoded), on_backgrounds(source)) / 10))


def inpainted(pixels: Pixels, alpha: Pixels) -> Pixels:
    """Replace pixels [H, W, 3] that alpha [H, W] hides by means over ever larger squares of visible pixels."""
    if alpha.all():
        return pixels
    share = np.asarray(alpha, np.float32) / np.float32(255)
    levels: list[tuple[Plane, Plane]] = [(pixels * share[..., None], share)]
    while max(alpha.shape) > 1 << (len(levels) - 1):
        levels.append((_halved(levels[-1][0]), _halved(levels[-1][1])))
    colours, weight = levels[-1]
    filled: NDArray[Any] = colours / np.maximum(weight, 1e-6)[..., None]
    for colours, weight in reversed(levels[:-1]):
        height, width = weight.shape
        coarse = cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR).reshape(height, width, 3)
        known = weight[..., None]
        filled = coarse * (1 - known) + colours
    return np.where(alpha[..., None] > 0, pixels, np.rint(np.clip(filled, 0, 255)).astype(np.uint8))


def _halved(plane: Plane) -> Plane:
    height, width = plane.shape[:2]
    size = max(-(-width // 2), 1), max(-(-height // 2), 1)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
