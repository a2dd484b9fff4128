"""Profile paper: structure-guided start, fit, quantisation-aware tuning, for a budget of any kind."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch

from sgmethod.bitstream import container
from sgmethod.decoder import draw
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.errors import BudgetError
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.recorder import Recorder
from sgmethod.metrics import psnr
from sgmethod.paper.fit import fit, level_of
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.schedule import Schedule
from sgmethod.paper.settings import PaperSettings
from sgmethod.paper.stream import PaperStream, file_bytes, smallest_file
from sgmethod.paper.tuning import Tuner, bits_per_gaussian
from sgmethod.scene import Pixels

SEED = 0  # of the initial places and of the codebook
FIT_SHARE = 0.6  # of the time left; the rest is for tuning
PSNR_UNTIL = (0.22, 0.46, 0.72, 1.0)  # of the time left: when attempts end, each a little longer than the last
EXPECTED_GROUPS = 2  # bitwidths: most Gaussians have the least, and some one bit more
USABLE_STEPS, USABLE_DB = 30, 20.0  # with less of both, as after a short time limit, nothing can be recognised
PSNR_PER_DOUBLING_DB = 1.7  # first guess in a search for a PSNR: gain from twice as many Gaussians


@dataclass(frozen=True)
class PaperProblem:
    """A picture to encode, uint8 [H, W, 3], and what its run has at hand."""

    pixels: Pixels
    settings: PaperSettings
    deadline: Deadline
    recorder: Recorder

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]


def encode(pixels: Pixels, asked: EncodeArguments, time_limit_s: float | None, recorder: Recorder) -> tuple[bytes, int]:
    """Encode pixels [H, W, 3]; return the file and the number of steps.

    Raises BudgetError for a budget that no file can meet, and for a time limit that leaves too few steps.
    """
    budget, settings = asked.budget, asked.settings
    assert isinstance(settings, PaperSettings)
    deadline = Deadline.from_limit(recorder.clock, time_limit_s, pixels.shape[0] * pixels.shape[1])
    if not deadline.left_s():  # loading PyTorch counts, too
        raise _too_short(recorder, 0)
    problem = PaperProblem(pixels, settings, deadline, recorder)
    with _torch_defaults(), _memory_errors():
        if budget.kind == "psnr":
            stream, steps = reach_psnr(problem, budget.value)
        elif budget.kind == "gaussians":
            stream, steps = run(problem, budget.max_gaussians(*problem.size), None)
        else:
            stream, steps = within_bytes(problem, budget.max_bytes(*problem.size) or 0)
    if deadline.has_limit() and steps < USABLE_STEPS and recorder.points[-1].psnr < USABLE_DB:
        raise _too_short(recorder, steps)
    return container.serialise(stream), steps


def within_bytes(problem: PaperProblem, max_bytes: int) -> tuple[PaperStream, int]:
    """Encode to at most max_bytes."""
    s, (width, height), smallest = problem.settings, problem.size, smallest_file(problem.settings)
    if max_bytes < smallest:
        raise BudgetError(f"a file of profile paper takes at least {smallest} bytes, the budget is {max_bytes}")
    bits = 8 * (max_bytes - file_bytes(0, EXPECTED_GROUPS))
    n = min(max(int(bits // bits_per_gaussian(s)), 1), width * height)
    return run(problem, n, max_bytes)


def reach_psnr(problem: PaperProblem, target_db: float) -> tuple[PaperStream, int]:
    """Search for the smallest stream that reaches target_db; return the best found if none does.

    Each attempt is a whole encode; the next number of Gaussians follows from the slope of PSNR over the logarithm of
    that number.
    """
    pixels = problem.size[0] * problem.size[1]
    n, steps = max(pixels // 300, 1), 0
    tried: dict[int, tuple[float, PaperStream]] = {}
    parts = [problem.deadline.after(share) for share in PSNR_UNTIL]
    for attempt in problem.deadline.attempts(len(parts)):
        part = replace(problem, deadline=parts[attempt])
        stream, taken = run(part, n, None)
        steps += taken
        tried[n] = (psnr(draw(stream.scene()), problem.pixels), stream)
        n = _next_count(tried, target_db, pixels)
        if n in tried:
            break
    reached = [m for m, (db, _) in tried.items() if db >= target_db]
    return tried[min(reached)][1] if reached else max(tried.values(), key=lambda t: t[0])[1], steps


def run(problem: PaperProblem, n: int, max_bytes: int | None) -> tuple[PaperStream, int]:
    """Encode n Gaussians, within max_bytes or else with bitwidths set by lambda_b; return stream and steps."""
    s, recorder = problem.settings, problem.recorder
    image = problem.pixels.astype(np.float32)
    image /= 255
    level = level_of(problem.pixels)
    start = place_by_structure(image, n, s.start, np.random.default_rng(SEED))
    fitted, fit_steps = fit(level, start, s, recorder, problem.deadline.after(FIT_SHARE))
    tuner = Tuner(fitted, level, s, max_bytes, SEED)
    schedule = Schedule("tune", s.tune_steps, s.optimiser.final_rate)
    steps = fit_steps + schedule.run(problem.deadline, recorder, tuner.step)
    return tuner.stream(), steps


@contextmanager
def _torch_defaults() -> Iterator[None]:
    """Compute on the CPU, with gradients, whatever the program has set.

    On one thread: torch's pool and the kernels' on the same cores would take several times as long.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with (
            torch.device("cpu"),
            torch.autocast("cpu", enabled=False),
            torch.inference_mode(False),
            torch.enable_grad(),
        ):
            yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _memory_errors() -> Iterator[None]:
    """Turn torch's RuntimeError on failed allocation into MemoryError."""
    try:
        yield
    except RuntimeError as error:
        if "can't allocate memory" not in str(error):
            raise
        raise MemoryError("not enough memory for this encode") from error


def _too_short(recorder: Recorder, steps: int) -> BudgetError:
    """Describe a time limit that ended the encode after so many steps, and what should be enough."""
    passed_s = recorder.clock.seconds()
    start_s = recorder.points[0].seconds if steps else passed_s
    enough_s = 2 * start_s + USABLE_STEPS * (passed_s - start_s) / max(steps, 1)
    return BudgetError(
        f"the time limit is too short: profile paper took {start_s:.1f} s to start, and then had {steps} steps of the "
        f"{USABLE_STEPS} that it needs; allow at least {enough_s:.1f} s"
    )


def _next_count(tried: dict[int, tuple[float, PaperStream]], target_db: float, limit: int) -> int:
    """Number of Gaussians to try next, from the two attempts nearest to the target."""
    nearest = sorted(tried, key=lambda m: abs(tried[m][0] - target_db))[:2]
    n, db, slope = nearest[0], tried[nearest[0]][0], PSNR_PER_DOUBLING_DB
    if len(nearest) == 2:
        slope = min(max((db - tried[nearest[1]][0]) / math.log2(n / nearest[1]), 0.5), 6.0)
    aim = target_db + 0.05  # a little above, because missing the target is worse than exceeding it
    doublings = min(max((aim - db) / slope, -4.0), 4.0)
    return min(max(round(n * 2**doublings), 1), limit)
