"""Alpha: a grey picture of its own in the file. Two requests in turn: alpha, then colours as far as it shows them.

An error e of a colour under alpha a is a e on any background, so it counts a^2: hidden pixels cost nothing. An
error d of alpha is d times the colour less the background. A file's error is the mean over a white and a black one.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw_whole
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.laying import on_backgrounds
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.rd import encode as pipeline
from sgmethod.rd.rate_control import RateControl, allows_alpha, beside_alpha, looks_db, missed_db, of_alpha, raised
from sgmethod.rd.request import Request
from sgmethod.trace import Preview, shown_to_nobody

Pixels = NDArray[np.uint8]
Plane = NDArray[np.float32]


def encode(request: Request, alpha: Pixels) -> tuple[StreamV2, int]:
    """The coded picture of a request with alpha [H, W], and the optimiser steps it took."""
    pixels = continued(request.pixels, alpha)
    layer, error, steps = _alpha(request, pixels, alpha)
    deadline, objective = request.deadline, request.objective.under(pixels, draw_whole(layer)[..., 0])
    recorder = replace(request.recorder, preview=_with_alpha(request.recorder.preview, layer))
    rate = beside_alpha(request.rate, layer, error)
    found: list[tuple[float, StreamV2]] = []
    for _ in deadline.tries(request.settings.alpha.tries):
        colours = replace(request, objective=objective, rate=rate, recorder=recorder, deadline=deadline.part(1.0))
        stream, taken = pipeline.encode(colours)
        steps += taken
        stream = replace(stream, alpha=layer)
        missing = missed_db(request.rate, _reached(request.rate, draw_whole(stream), pixels, alpha))
        found.append((missing, stream))
        if missing == 0:
            break
        rate = raised(rate, missing)  # colours do not know all of the error: both layers are rounded and clamped
    return min(found, key=lambda one: one[0])[1], steps


def _alpha(request: Request, pixels: Pixels, alpha: Pixels) -> tuple[StreamV2, float, int]:
    """The coded alpha plane, the file's error if nothing else were wrong, and the steps it took."""
    s, steps = request.settings, 0
    rate, deadline = of_alpha(request.rate), request.deadline.part(s.alpha.time)
    objective, recorder = Objective.of_alpha(alpha, s.objective), Recorder(request.recorder.clock)
    settings = replace(s, effort=replace(s.effort, rounds=(0,)))
    for _ in deadline.tries(s.alpha.tries):
        plane = replace(
            request,
            objective=objective,
            rate=rate,
            deadline=deadline.part(1.0),
            settings=settings,
            recorder=recorder,
            with_shear=True,
        )
        layer, taken = pipeline.encode(plane)
        steps += taken
        error = _error(np.dstack([pixels, draw_whole(layer)[..., 0]]), pixels, alpha)
        if allows_alpha(request.rate, error):
            break
        rate = replace(rate, quantum=rate.quantum / 2)
    return layer, error, steps


def _reached(rate: RateControl, decoded: Pixels, pixels: Pixels, alpha: Pixels) -> float:
    """What decoded pixels [H, W, 4] have of what is asked for, in dB."""
    if not rate.by_looks:
        return -10 * math.log10(max(_error(decoded, pixels, alpha), 1e-12))
    found = map(ssimulacra2, on_backgrounds(decoded), on_backgrounds(np.dstack([pixels, alpha])))
    return looks_db(statistics.fmean(one for one in found if one is not None))


def _error(decoded: Pixels, pixels: Pixels, alpha: Pixels) -> float:
    """The mean squared error of decoded pixels [H, W, 4], 1 being white."""
    return float(10 ** (-psnr(on_backgrounds(decoded), on_backgrounds(np.dstack([pixels, alpha]))) / 10))


def _with_alpha(preview: Preview, alpha: StreamV2) -> Preview:
    """A preview that is given files with alpha."""
    if preview is shown_to_nobody:
        return preview

    def shown(file: bytes) -> None:
        stream = container.parse(file)
        assert isinstance(stream, StreamV2)
        preview(container.serialise(replace(stream, alpha=alpha)))

    return shown


def continued(pixels: Pixels, alpha: Pixels) -> Pixels:
    """Pixels [H, W, 3] in which those that alpha [H, W] hides continue their surroundings: means over ever larger
    squares of visible pixels fill the gaps."""
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
