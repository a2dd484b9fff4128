"""The backend for fits of several pictures at once: each runs in a thread of its own, and their steps are one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition, Event

import torch
from torch import Tensor

from sgmethod.backend.pairs import Pairs
from sgmethod.backend.protocol import Descent, Frame, Moments
from sgmethod.backend.tensors import Tensors
from sgmethod.backend.tiles import Tiles
from sgmethod.errors import SgError
from sgmethod.scene import Gaussians

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


class Together(Tensors):
    """A backend for a given number of threads, each of which leaves it, as a context manager, after its fit.

    Steps are taken once every thread that has not left asks for some.
    """

    def __init__(self, device: torch.device, threads: int, abandoned: Event) -> None:
        super().__init__(device, tiled=True)
        self._threads, self._abandoned = threads, abandoned
        self._asked: list[_PendingSteps] = []
        self._condition = Condition()

    def __enter__(self) -> Together:
        return self

    def __exit__(self, *_: object) -> None:
        with self._condition:
            self._threads -= 1
            self._take_if_all_ask()

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> None:
        """As Backend does. Raises SgError once the fits are abandoned, and errors of the whole batch."""
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

    # A device does one thing at a time, and Triton's interpreter allows no more.

    def _drawn(self, gaussians: Gaussians, frame: Frame) -> tuple[Pairs | Tiles, Tensor]:
        with self._condition:
            return super()._drawn(gaussians, frame)

    def _gradient(self, drawn: Pairs | Tiles, gaussians: Gaussians, frame: Frame, by_image: Tensor) -> Gaussians:
        with self._condition:
            return super()._gradient(drawn, gaussians, frame, by_image)
