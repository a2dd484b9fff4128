"""The paper's quantisation-aware fine-tuning: Gaussians -> integer codes (sections III-C to III-E).

Positions are quantised by LSQ, factors by ABQ, colours by residual vector quantisation, all learned together under

    L_tune = MSE + lambda_g L_g + lambda_b L_b + lambda_r L_r.

Where a file must not exceed a budget of bytes, all soft bitwidths are lowered by a common amount until it fits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sgmethod.backend.protocol import Moments
from sgmethod.fitting.level import Level
from sgmethod.paper import lattice
from sgmethod.paper.adam import Adam
from sgmethod.paper.codebook import ResidualCodebook
from sgmethod.paper.fit import KERNELS, descent_on, loss_of
from sgmethod.paper.settings import PaperSettings
from sgmethod.paper.stream import CODEBOOK_ENTRIES, CODEBOOK_STAGES, Group, PaperStream, file_bytes, record_bits
from sgmethod.scene import Gaussians

MIN_SPAN_PX = 1e-3
FIT_BUDGET_EVERY = 20  # steps between two shifts of the bitwidths onto the budget


def bits_per_gaussian(settings: PaperSettings) -> float:
    """Expected bits of one Gaussian's record."""
    return record_bits(settings.position_bits, 0) + 3 * settings.mean_bitwidth


@dataclass(frozen=True)
class Parameters:
    """Tensors of N Gaussians, for autograd through the quantisers: means [N, 2], factors [N, 3], colors [N, 3]."""

    means: Tensor
    factors: Tensor
    colors: Tensor

    @classmethod
    def from_gaussians(cls, gaussians: Gaussians) -> Parameters:
        """Copy arrays to tensors."""
        return cls(*(torch.tensor(values) for values in gaussians.arrays))

    @classmethod
    def sharing(cls, gaussians: Gaussians) -> Parameters:
        """Wrap arrays in tensors that share their memory."""
        return cls(*(torch.from_numpy(values) for values in gaussians.arrays))

    def numpy(self) -> Gaussians:
        """Return arrays, which share the tensors' memory where that is contiguous."""
        return Gaussians(*(values.detach().contiguous().numpy() for values in (self.means, self.factors, self.colors)))


class Tuner:
    """Latent parameters, their quantisers and their optimisers."""

    def __init__(
        self, gaussians: Gaussians, level: Level, settings: PaperSettings, max_bytes: int | None, seed: int
    ) -> None:
        """Start from fitted Gaussians. max_bytes: largest size of the file; None to let lambda_b decide."""
        self.level, self.max_bytes = level, max_bytes
        s = self.settings = settings
        self.loss, self.descent = loss_of(level, s.lambda_g), descent_on(level, s)
        self.p = Parameters.from_gaussians(gaussians)
        self.n = len(gaussians)
        means, factors, tail = self.p.means, self.p.factors, s.range_quantile
        self.book = ResidualCodebook(
            self.p.colors, stages=CODEBOOK_STAGES, entries=CODEBOOK_ENTRIES, decay=s.codebook_decay, seed=seed
        )
        self.position_bits = torch.tensor([s.position_bits], dtype=torch.float32)
        self.ranges = [means.amin(0), means.amax(0), factors.quantile(tail, dim=0), factors.quantile(1 - tail, dim=0)]
        self._widen()
        bits = s.start_bitwidth if s.adaptive_bitwidth else s.min_bitwidth
        self.soft_bits = torch.full((self.n, 1), bits, dtype=torch.float32)
        self.shift = 0.0
        self.steps = 0
        spans = [(high - low).amax().item() for low, high in (self.ranges[:2], self.ranges[2:])]
        rates = [s.range_rate * spans[i // 2] for i in range(4)]
        rates.append(s.bits_rate if s.adaptive_bitwidth else 0.0)
        self.optimiser = Adam([*self.ranges, self.soft_bits], rates, (s.optimiser.beta1, s.optimiser.beta2))
        self.moments = Moments.none(self.n)
        self.fit_budget()
        self.best, self._kept = math.inf, (self._state(), self.shift)

    def _widen(self) -> None:
        """Keep every range at least MIN_SPAN_PX wide, because a range of zero or negative width has no step."""
        self.ranges[2][[0, 2]] = self.ranges[2][[0, 2]].clamp_min(self.settings.optimiser.min_scale_px)
        for low, high in (self.ranges[:2], self.ranges[2:]):
            high.copy_(torch.maximum(high, low + MIN_SPAN_PX))

    def bits(self) -> Tensor:
        """Soft bitwidths [N, 1], shifted and clamped to the allowed range."""
        return (self.soft_bits + self.shift).clamp(self.settings.min_bitwidth, self.settings.max_bitwidth)

    def file_bytes(self) -> int:
        """Size of the file with the current bitwidths."""
        hard, fixed = torch.round(self.bits()).long(), self.n * record_bits(self.settings.position_bits, 0)
        return file_bytes(fixed + 3 * int(hard.sum()), int((torch.bincount(hard[:, 0]) > 0).sum()))

    def fit_budget(self) -> None:
        """Lower all soft bitwidths until the file is within the budget; raise them to use it up if bits_by_budget."""
        if self.max_bytes is None or not self.settings.adaptive_bitwidth:
            return
        low, high = -64.0, 64.0 if self.settings.bits_by_budget else 0.0
        self.shift = high
        if self.file_bytes() <= self.max_bytes:
            return
        for _ in range(32):
            self.shift = (low + high) / 2
            low, high = (self.shift, high) if self.file_bytes() <= self.max_bytes else (low, self.shift)
        self.shift = low

    def quantised(self) -> tuple[Parameters, Tensor]:
        """Gaussians as decoded, differentiable in latents, ranges and bitwidths, and their colour indices [N, 2]."""
        first, last, low, high = self.ranges
        means = lattice.quantise(self.p.means, first, last, self.position_bits)
        factors = lattice.quantise(self.p.factors, low, high, self.bits(), self.settings.printed_gradient)
        index = self.book.assign(self.p.colors)
        return Parameters(means, factors, self.book.lookup(index)), index

    def step(self, rate: float) -> tuple[float, int, int]:
        """Take one step of all parameters; return the quantised picture's error, Gaussians, and the file's bytes."""
        if self.steps % FIT_BUDGET_EVERY == 0:
            self.fit_budget()
        self.steps += 1
        leaves = [self.p.means, self.p.factors, *self.ranges, self.soft_bits]
        for leaf in leaves:
            leaf.requires_grad_()
        quantised, index = self.quantised()
        with torch.no_grad():
            mse, found = self.loss(quantised.numpy())
            self._keep_if_best(mse)
            grad = Parameters.sharing(found)
        # A scalar: for gradients of tensors, torch.autograd first loads SymPy for seconds.
        slope = (quantised.means * grad.means).sum() + (quantised.factors * grad.factors).sum()
        grads = torch.autograd.grad(slope, leaves)
        with torch.no_grad():
            for leaf in leaves:
                leaf.requires_grad_(False)
            self._move((grads[0], grads[1], grad.colors), list(grads[2:]), quantised.colors, rate)
            self.book.update(self.p.colors, index)
        return mse, self.n, self.file_bytes()

    def _state(self) -> list[Tensor]:
        """All that a file is made of."""
        return [self.p.means, self.p.factors, self.p.colors, *self.ranges, self.soft_bits, self.book.entries]

    def _keep_if_best(self, mse: float) -> None:
        """Keep the state if none before it was better: error and price of bits or, with a budget, error within it."""
        if self.max_bytes is None:
            mse += self.settings.lambda_b * self.bits().mean().item()
        elif self.file_bytes() > self.max_bytes:
            return
        if mse < self.best:
            self.best, self._kept = mse, ([one.clone() for one in self._state()], self.shift)

    def _restore_best(self) -> None:
        """Return to the best state, as GaussianImage does."""
        with torch.no_grad():
            self._keep_if_best(self.loss(self.quantised()[0].numpy())[0])
            state, self.shift = self._kept
            for one, kept in zip(self._state(), state, strict=True):
                one.copy_(kept)

    def _move(
        self, grads: tuple[Tensor, Tensor, Tensor], others: list[Tensor], coded_colors: Tensor, rate: float
    ) -> None:
        s = self.settings
        by_colors = grads[2] + 2 * s.lambda_r / coded_colors.numel() * (self.p.colors - coded_colors)  # L_r
        gradient = Parameters(grads[0], grads[1], by_colors).numpy()
        KERNELS.step(self.p.numpy(), gradient, self.moments, self.descent, rate * s.tune_rate)
        # L_b, or with a budget in its place the price at which the mean bitwidth stays the same.
        price = others[4].mean() if s.bits_by_budget and self.max_bytes is not None else -s.lambda_b / self.n
        others[4] = others[4] - price
        self.optimiser.step(others, rate)
        self._widen()

    def stream(self) -> PaperStream:
        """Code the best Gaussians as syntax elements, grouped by bitwidth, from top to bottom in each group."""
        self.fit_budget()
        self._restore_best()
        first, last, low, high = self.ranges
        positions = lattice.codes(self.p.means, first, last, self.position_bits).numpy().astype(np.uint16)
        factors = lattice.codes(self.p.factors, low, high, self.bits()).numpy().astype(np.uint16)
        colors = self.book.assign(self.p.colors).numpy().astype(np.uint8)
        hard = torch.round(self.bits())[:, 0].numpy().astype(int)
        groups = []
        for bitwidth in np.unique(hard):
            rows = np.flatnonzero(hard == bitwidth)
            rows = rows[np.argsort(positions[rows, 1], kind="stable")]
            groups.append(Group(int(bitwidth), positions[rows], factors[rows], colors[rows]))
        return PaperStream(
            profile="paper",
            width=self.level.frame.width,
            height=self.level.frame.height,
            position_bits=self.settings.position_bits,
            position_range=torch.stack([first, last], 1).numpy(),
            factor_range=torch.stack([low, high], 1).numpy(),
            codebooks=self.book.entries.numpy().astype(np.float16),
            groups=tuple(groups),
        )
