"""The backend for fits of several pictures at once: each runs in a thread of its own, and their steps are one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition, Event

import numpy as np
import torch
from torch import Tensor

from sgmethod.backend.protocol import Descent, Frame, Moments
from sgmethod.errors import SgError
from sgmethod.scene import Gaussians
from sgmethod.torch.tensors import Backward, Tensors, to_numpy
from sgmethod.torch.tiles import Tiles

POLLED_S = 0.05


@dataclass
class _PendingSteps:
    """Steps that a thread waits for."""

    gaussians: Gaussians
    moments: Moments
    descent: Descent
    rates: tuple[float, ...]
    is_done: bool = False
    error: Exception | None = None

    @property
    def kind(self) -> tuple[object, ...]:
        """What must be equal for two to be taken together."""
        d = self.descent
        return d.frame, d.width, d.height, d.settings, self.rates


class BatchedTensors(Tensors):
    """A backend by Triton's kernels, for a number of threads, each of which leaves it after its fit.

    Steps are taken once every thread that has not left asks for some. To leave is to exit it as a context manager.
    """

    def __init__(self, device: torch.device, threads: int, abandoned: Event) -> None:
        super().__init__(device)
        self._threads, self._abandoned = threads, abandoned
        self._asked: list[_PendingSteps] = []
        self._condition = Condition()

    def __enter__(self) -> BatchedTensors:
        return self

    def __exit__(self, *_: object) -> None:
        with self._condition:
            self._threads -= 1
            self._take_if_all_ask()

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        """As Backend does, but returns no errors before steps.

        Raises SgError once the fits are abandoned, and errors of the whole batch.
        """
        asked = _PendingSteps(gaussians, moments, descent, tuple(rates))
        with self._condition:
            self._asked.append(asked)
            self._take_if_all_ask()
            while not asked.is_done:
                if self._abandoned.is_set():  # some of the threads may never begin
                    raise SgError("the fits were abandoned")
                self._condition.wait(POLLED_S)
        if asked.error is not None:
            raise asked.error
        return []

    def _take_if_all_ask(self) -> None:
        if not self._asked or len(self._asked) < self._threads:
            return
        asked, self._asked = self._asked, []
        for kind in dict.fromkeys(one.kind for one in asked):
            alike = [one for one in asked if one.kind == kind]
            try:
                self.steps_of([(one.gaussians, one.moments, one.descent) for one in alike], alike[0].rates)
            except Exception as error:  # as where the device has no memory left
                for one in alike:
                    one.error = error
            for one in alike:
                one.is_done = True
        self._condition.notify_all()

    def steps_of(self, fits: Sequence[tuple[Gaussians, Moments, Descent]], rates: Sequence[float]) -> None:
        """Take the steps of several fits, whose frames, sizes and settings are alike.

        From the first step to the last nothing leaves the device.
        """
        largest = max(len(gaussians) for gaussians, _, _ in fits)
        arrays = [(*one.arrays, moments.first, moments.second, moments.bias) for one, moments, _ in fits]
        filled = ([np.pad(one, ((0, largest - len(one)), (0, 0))) for one in of] for of in zip(*arrays, strict=True))
        state = [self._tensor(np.stack(values)) for values in filled]
        descents = [descent for _, _, descent in fits]
        target = torch.stack([self._image(one.target) for one in descents])
        quanta = [one.quantum if one.price > 0 else 1.0 for one in descents]  # it may be 0 where bits are free
        prices = [one.price for one in descents]
        bits = [self._tensor(np.array(of, np.float32)) for of in (quanta, prices)]
        for rate in rates:
            Tiles(descents[0].frame, *state[:3]).step(state[3:], bits, target, descents[0], rate)
        for values, of in zip(state, zip(*arrays, strict=True), strict=True):
            for found, one in zip(to_numpy(values), of, strict=True):
                one[...] = found[: len(one)]

    # A device does one thing at a time, and Triton's interpreter allows no more.

    def _drawn(self, gaussians: Gaussians, frame: Frame) -> tuple[Tensor, Backward]:
        with self._condition:
            tiles = Tiles(frame, *(self._tensor(values)[None] for values in gaussians.arrays))
            drawn = tiles.draw()[0]

        def backward(by_image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            with self._condition:
                means, factors, colors = tiles.gradients(by_image[None])
            return means[0], factors[0], colors[0]

        return drawn, backward
