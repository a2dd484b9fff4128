"""The fit of profile rd: Gaussians are placed, moved, added and dropped under the price of their bits.

Few Gaussians are placed by structure. Then all are fitted together. At set times Gaussians whose energy is not worth
their bits are dropped, the quantum is steered, and new Gaussians are added where they take more error away than their
bits are worth.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES
from sgmethod.fitting import eye, leads
from sgmethod.fitting.adam import FrameAdam
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Picture, target_of
from sgmethod.fitting.recorder import Clock
from sgmethod.native import native
from sgmethod.profiles import PAPER, RdSettings, Times, hurried
from sgmethod.rd import growth, quantiser, texture
from sgmethod.rd.pyramid import Pyramid
from sgmethod.rd.quantiser import Coder
from sgmethod.rd.rate_control import RateControl
from sgmethod.start.placement import place
from sgmethod.trace import Preview, shown_to_nobody

FEWEST_AT_START = 4
START = replace(PAPER, shared_by_area=False)
MANY_VALUES = 1 << 23  # of a picture; a smaller one's growth leaves little memory, and asking for it anew takes time
FEW = 0.001  # new Gaussians, as a part of those that there are
GRADIENTS_PER_STEP = 4.0  # at the start: the time of a step of the schedule, on average
SHORT = 4.0  # times what the pictures took: where less is left, places are looked for on few pixels
GRID_REACH = 1.6  # scales of a Gaussian; two cells are at least 1.68


class RdFit:
    """The state of one fit: the Gaussians, the optimiser's averages of them, and the coder with the quantum."""

    def __init__(
        self,
        pixels: NDArray[np.uint8],
        control: RateControl,
        seed: int,
        clock: Clock,
        preview: Preview = shown_to_nobody,
        alpha: NDArray[np.uint8] | None = None,
        left_s: float = math.inf,
    ) -> None:
        """pixels [H, W, 3]; preview: is given the file as it would be now, whenever its size is looked at; alpha:
        [H, W], what shows of the pixels, where they are not opaque; left_s: seconds that there are for the fit, with
        all that is done here, which made_s then says."""
        began = clock.seconds()
        self.control, self.clock, self.preview = control, clock, preview
        self.settings = settings = control.settings
        self.pixels = pixels
        self.height, self.width = int(pixels.shape[0]), int(pixels.shape[1])
        self.coder = Coder.of(pixels, control.quantum, settings.with_shear)
        shown = None if alpha is None else eye.shown_by(alpha)
        seen = eye.visibility_of(pixels, shown) if settings.tune == "visual" else shown
        self.seen = None if seen is None else eye.Seen(seen)
        target = target_of(pixels, self.coder.background)
        lead: leads.Lead | None = None
        if settings.overshoot > 0:
            lead = leads.Overshoot(target, pixels, settings.overshoot)
        elif settings.tune == "visual":
            lead = leads.CoarseError(target)
        self.picture = Picture(target, 0.0, native.CUTOFF_V3, pyramid=True, visibility=seen, shown=shown, lead=lead)
        self.pyramid = Pyramid(self.picture, settings)
        self.size = 0  # of the file in bytes, about
        self.steps = 0
        self.due = _all_due(settings.times)
        self.price_of_none = math.inf  # at which growth found next to nothing
        took = clock.seconds() - began
        self.p = self._place(np.random.default_rng(seed), left_s - took < SHORT * took)
        self.adam = FrameAdam(len(self.p.means), settings, self.picture.values)
        self.made_s = clock.seconds() - began

    def _place(self, rng: np.random.Generator, is_short: bool) -> Parameters:
        """A part of the expected Gaussians, where the structure is. They are few, so a small picture shows enough; a
        smaller one has to do if time is short."""
        share = int(self.control.expected_gaussians() * self.settings.start_share)
        n = min(max(share, FEWEST_AT_START), self.control.most_gaussians(1.0))
        picture = self.pyramid.smallest(n // 4 if is_short else n)
        image = picture.rows(0, picture.height).transpose(1, 2, 0) + np.array(self.coder.background, np.float32) / 255
        placed = Parameters.of(place(np.ascontiguousarray(image), n, START, rng))
        means, factors = placed.means * picture.spacing, placed.factors * picture.spacing
        return Parameters(means, factors, picture.solve_colors(means, factors, self.settings.color_solve_steps))

    def hurry(self, seconds: float) -> None:
        """Where so many seconds are too few, take the settings of a lower effort; where they are too few for that as
        well, fit a smaller picture.

        Gradients are timed at the start. Too few for a picture are less seconds than all steps would take at the
        fastest of them; a step of the schedule takes some times as long, as there are more Gaussians later.
        """
        whole_s = self._gradient_s(self.picture)
        part = seconds / (GRADIENTS_PER_STEP * whole_s * self.control.steps())  # of the schedule, in that time
        self._go_by(hurried(self.settings, self.control.pixels, part * self.settings.steps))
        self.pyramid.choose_finest(seconds / self.control.steps(), whole_s, self._gradient_s)
        # What is narrower falls between the pixels.
        narrowest = self.settings.min_scale_px * self.pyramid.finest.spacing
        self.adam = FrameAdam(len(self.p.means), replace(self.settings, min_scale_px=narrowest), self.picture.values)

    def _gradient_s(self, picture: Picture) -> float:
        """Seconds that a gradient takes, the fastest of three: the first one also touches new memory."""
        times = []
        for _ in range(3):
            began = self.clock.seconds()
            picture.gradients(self.p)
            times.append(self.clock.seconds() - began)
        return min(times)

    def _go_by(self, settings: RdSettings) -> None:
        self.settings = settings
        self.control = replace(self.control, settings=settings)
        self.due = _all_due(settings.times)

    def step(self, rate: float, progress: float) -> tuple[float, tuple[int, int]]:
        """One optimiser step, after whatever is due at this part of the schedule."""
        at = None
        while self.due and progress >= self.due[0]:
            at = self.due.pop(0)
        if at is not None:  # of several that one slow step has passed, the last
            self._reconsider(at)
        picture = self.pyramid.at(progress, self.settings.times, len(self.p.means))
        lead = picture.lead
        has_grown = progress > self.settings.times.growth_at[-1]
        if lead is not None and self.steps % lead.EVERY == 0 and (has_grown or lead.WHILE_GROWING):
            picture.follow(self.p)
        self.steps += 1
        mse = _take_step(picture, self.picture, self.p, self.adam, rate, self.coder.quantum, self._price())
        return mse if picture is self.picture else math.inf, (len(self.p.means), 8 * self.size)

    def begin_round(self) -> None:
        """Make ready for a run of the schedule that is a round."""
        self._go_by(replace(self.settings, times=self.settings.round_times))
        self.price_of_none = math.inf

    def decoded_mse(self) -> float:
        """The error of the picture as it would decode now."""
        return self.picture.error(self.coder.rounded(self.p))

    def settle(self) -> None:
        """What the end of the schedule does, and a time limit may have skipped."""
        if self.control.max_gaussians is not None:
            self._drop(self.settings.bits_of_nothing, self.control.max_gaussians)

    def _price(self) -> float:
        """Squared error, summed over the picture, that a bit has to be worth."""
        return self.settings.rate_weight * quantiser.error_per_bit(self.coder.quantum)

    def _reconsider(self, at: float) -> None:
        """Drop Gaussians, steer the quantum and, while growing, add Gaussians; later hide grain, for the eye."""
        s, most = self.settings, self.control.most_gaussians(at)
        self._drop(s.bits_of_dropped if at >= s.times.growth_at[-1] else s.bits_of_nothing, most)
        self._steer(at)
        if at in s.times.growth_at:
            self._grow(most, at)
        lead = self.picture.lead
        whole = self.pyramid.finest is self.picture
        if whole and at >= s.times.excess_until and isinstance(lead, leads.CoarseError) and lead.grain is None:
            # The fit leaves about what it will leave in the end.
            lead.grain = texture.grain(self.pixels, self.picture.left(self.p), s)
            self.picture.follow(self.p)

    def _drop(self, bits: float, most: int) -> None:
        """Remove Gaussians whose energy is not worth so many bits, and the least of those beyond so many."""
        energies = quantiser.energies(self.p)
        if self.seen is not None:
            energies *= torch.from_numpy(self.seen.of(self.p))
        if len(energies) > most:
            energies[torch.argsort(energies, stable=True)[: len(energies) - most]] = 0
        keep = torch.nonzero(energies > bits * quantiser.error_per_bit(self.coder.quantum))[:, 0]
        if len(keep) == len(self.p.means):
            return
        kept = self.p.rows(keep)
        psnr = self.control.psnr
        if psnr is not None and self._rounded_psnr(kept) < psnr - self.settings.missed_db:
            return  # none would come back once the growth is over
        self.p = kept
        self.adam.select(keep)

    def _steer(self, at: float) -> None:
        """Move the quantum as the rate control says."""
        stream = self.coder.stream(self.p)
        self.size = HEADER_BYTES + len(stream.payload)
        if self.preview is not shown_to_nobody:
            self.preview(container.serialise(stream))
        psnrs = (lambda: self._rounded_psnr(self.p)), (lambda: self._psnr(self.p))
        quantum = self.control.steered(self.coder.quantum, at, self.size, *psnrs)
        if quantum != self.coder.quantum:
            self.coder = self.coder.with_quantum(quantum)

    def _grow(self, most: int, at: float) -> None:
        """Add Gaussians where they gain more than their bits are worth, so many in all at most. They are looked for on
        the level of the pyramid that will do for them."""
        s = self.settings
        if self._price() >= self.price_of_none:
            return  # the error has not grown since, nor will what pays
        n = len(self.p.means)
        room = min(self.control.new_gaussians(n), most - n)
        picture = self.pyramid.at(at, s.times, n + room)
        least_gain = self._price() * s.bits_of_new / picture.spacing**2
        hidden_by = s.hidden_by_visual if s.tune == "visual" else s.hidden_by
        new = growth.new_gaussians(picture, self.p, room, least_gain, s.color_solve_steps, hidden_by)
        if len(new.means) < min(room, FEW * n):
            self.price_of_none = self._price()
        if len(new.means) == 0:
            return
        self.p = self.p.with_more(new)
        self.size = self.size * len(self.p.means) // max(n, 1)
        self.adam.extend(len(new.means))
        self._sort()
        if self.picture.values > MANY_VALUES:
            native.release_memory()

    def _sort(self) -> None:
        """By place, along bands as high as a tile: what a tile needs then lies together in memory."""
        means = self.p.means
        order = torch.argsort((means[:, 1] / native.TILE_HEIGHT).floor() * 2 * self.width + means[:, 0], stable=True)
        self.p = self.p.rows(order)
        self.adam.select(order)

    def _rounded_psnr(self, p: Parameters) -> float:
        return self._psnr(self.coder.rounded(p))

    def _psnr(self, p: Parameters) -> float:
        return -10 * math.log10(max(self.picture.error(p), 1e-12))


def relaxed(
    picture: Picture, p: Parameters, held: NDArray[np.bool_], quantum: float, settings: RdSettings
) -> Parameters:
    """Gaussians [N] of a whole picture after some steps on what those of them that are held [N] leave of it."""
    before, frozen = p, torch.from_numpy(held)
    p, adam = p.copy(), FrameAdam(len(p.means), settings, picture.values)
    price = settings.relaxed_weight * quantiser.error_per_bit(quantum)
    for _ in range(settings.relaxed_steps):
        _take_step(picture, picture, p, adam, settings.relaxed_rate, quantum, price)
        for moved, held_at in zip(p.tensors(), before.tensors(), strict=True):
            moved[frozen] = held_at[frozen]
    return p


def _take_step(
    picture: Picture, whole: Picture, p: Parameters, adam: FrameAdam, rate: float, quantum: float, price: float
) -> float:
    """Move p, in place, by one step on a picture that is the whole one or smaller; returns its error before that. They
    stay where the file can put them: centres within two cells of the picture, each about as wide as they are."""
    mse, grad = picture.gradients(p)
    quantiser.add_rate_gradient(p, grad, quantum, price / whole.values)
    adam.step(p, grad, rate)
    native.keep_in_range(GRID_REACH, whole.width, whole.height, *(t.numpy() for t in p.tensors()))
    return mse


def _all_due(times: Times) -> list[float]:
    """All that something is due at."""
    return sorted([*times.growth_at, *times.trim_at])
