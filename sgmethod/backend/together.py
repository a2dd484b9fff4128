"""The backend for fits of several pictures at once: each runs in a thread of its own, and their steps are one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Condition

import torch
from torch import Tensor

from sgmethod.backend.pairs import Pairs
from sgmethod.backend.protocol import Descent, Frame, Moments
from sgmethod.backend.tensors import Tensors
from sgmethod.backend.tiles import Tiles
from sgmethod.errors import SgError
from sgmethod.scene import Gaussians


@dataclass
class _Asked:
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
    """A backend for a given number of threads, each of which calls leave() after its fit.

    Steps are taken once every thread that has not left asks for some.
    """

    def __init__(self, device: torch.device, threads: int) -> None:
        super().__init__(device, tiled=True)
        self._threads, self._has_ended = threads, False
        self._asked: list[_Asked] = []
        self._meeting = Condition()

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> None:
        """As Backend does; raises SgError after end(), and what another thread's part of the batch raises."""
        asked = _Asked(gaussians, moments, descent, tuple(rates))
        with self._meeting:
            self._asked.append(asked)
            self._take_if_all_ask()
            self._meeting.wait_for(lambda: asked.is_done or self._has_ended)
        if asked.error is not None:
            raise asked.error
        if not asked.is_done:
            raise SgError("the fits were abandoned")

    def leave(self) -> None:
        """Say that one thread asks for no more steps."""
        with self._meeting:
            self._threads -= 1
            self._take_if_all_ask()

    def end(self) -> None:
        """Let nobody wait any more, as where some threads will never begin."""
        with self._meeting:
            self._has_ended = True
            self._meeting.notify_all()

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
        self._meeting.notify_all()

    # A device does one thing at a time, and Triton's interpreter allows no more.

    def _drawn(self, gaussians: Gaussians, frame: Frame) -> tuple[Pairs | Tiles, Tensor]:
        with self._meeting:
            return super()._drawn(gaussians, frame)

    def _gradient(self, drawn: Pairs | Tiles, gaussians: Gaussians, frame: Frame, by_image: Tensor) -> Gaussians:
        with self._meeting:
            return super()._gradient(drawn, gaussians, frame, by_image)
