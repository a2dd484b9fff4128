"""The lattice quantisers against finite differences of their smooth surrogate, the colour codebook, and tuning.

The surrogate of v^ = low + s round(u), u = (v - low) / s, holds the offset r = round(u) - u of the rounding constant
while v, low, high and B = b (a real number there) vary; out of range it holds which end v^ sits at.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from sgmethod.decoder import draw
from sgmethod.paper.codebook import ResidualCodebook, kmeans
from sgmethod.paper.fit import level_of
from sgmethod.paper.lattice import codes, quantise
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.settings import PAPER
from sgmethod.paper.tuning import Tuner
from tests.support.pictures import photo

DIFFERENCE = 1e-6  # of the central differences, in float64
GRADIENT_TOLERANCE = 1e-8  # worst seen 1.1e-9, from the differences


def surrogate(v: Tensor, low: Tensor, high: Tensor, bits: Tensor, at: tuple[Tensor, ...]) -> Tensor:
    """v^ around the point `at` = (v, low, high, bits) where rounding and clamping are decided."""
    v0, low0, high0, bits0 = at
    u0 = (v0 - low0) / ((high0 - low0) / (torch.exp2(bits0) - 1))
    offset = torch.round(u0) - u0
    step = (high - low) / (torch.exp2(bits) - 1)
    inside = low + step * ((v - low) / step + offset)
    return torch.where(v0 < low0, low + 0 * v, torch.where(v0 > high0, high + 0 * v, inside))


def lsq() -> tuple[Tensor, ...]:
    """Two columns, one bitwidth for all."""
    generator = torch.Generator().manual_seed(1)
    v = torch.rand(40, 2, generator=generator, dtype=torch.float64) * 3 - 1
    low, high = torch.tensor([-0.5, -0.2], dtype=torch.float64), torch.tensor([1.4, 1.7], dtype=torch.float64)
    return v, low, high, torch.tensor([4.0], dtype=torch.float64)


def abq() -> tuple[Tensor, ...]:
    """Three columns, a bitwidth for each row."""
    generator = torch.Generator().manual_seed(2)
    v = torch.rand(40, 3, generator=generator, dtype=torch.float64) * 3 - 1
    low, high = (torch.tensor(r, dtype=torch.float64) for r in ([-0.5, -0.2, 0.1], [1.4, 1.7, 1.2]))
    bits = torch.randint(1, 9, (40, 1), generator=generator).double()
    return v, low, high, bits


SHAPES = {"LSQ": lsq, "ABQ": abq}


@pytest.mark.parametrize("shape", SHAPES)
def test_values(shape: str) -> None:
    v, low, high, bits = SHAPES[shape]()
    found = quantise(v, low, high, bits)
    assert ((v < low).any(0) & (v > high).any(0) & ((v > low) & (v < high)).any(0)).all()  # all cases occur
    for i, j in itertools.product(*map(range, v.shape)):
        top = 2 ** round(bits.reshape(-1)[min(i, bits.numel() - 1)].item()) - 1
        a, b = low[j].item(), high[j].item()
        step = (b - a) / top
        code = min(max(round((v[i, j].item() - a) / step), 0), top)
        assert found[i, j].item() == pytest.approx(a + step * code, abs=1e-14)  # worst error seen 3e-16


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("argument", range(4), ids=("v", "low", "high", "bits"))
def test_gradients_are_those_of_the_surrogate(shape: str, argument: int) -> None:
    at = SHAPES[shape]()
    upstream = torch.randn(at[0].shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    leaves = [t.clone().requires_grad_() for t in at]
    (found,) = torch.autograd.grad(quantise(*leaves), leaves[argument], upstream)
    assert found.shape == at[argument].shape
    for k in range(at[argument].numel()):
        ends = []
        for sign in (1, -1):
            moved = [t.clone() for t in at]
            moved[argument].view(-1)[k] += sign * DIFFERENCE
            ends.append((surrogate(moved[0], moved[1], moved[2], moved[3], at) * upstream).sum())
        difference = (ends[0] - ends[1]).item() / (2 * DIFFERENCE)
        assert found.view(-1)[k].item() == pytest.approx(difference, abs=GRADIENT_TOLERANCE)


def test_the_printed_gradient_is_equation_7() -> None:
    """Which is larger than the right one, and holds bitwidths up against their price."""
    v, low, high, bits = abq()
    soft = bits.clone().requires_grad_()
    (found,) = torch.autograd.grad(quantise(v, low, high, soft, printed=True).sum(), soft)
    top = torch.exp2(bits) - 1
    step, q = (high - low) / top, codes(v, low, high, bits)
    expected = torch.exp2(bits) * math.log(2) / top * torch.where((v < low) | (v > high), -step * q, v - q)
    assert torch.allclose(found, expected.sum(1, keepdim=True))


def test_the_bitwidth_is_rounded() -> None:
    v, low, high, bits = abq()
    leaf, soft = bits.clone().requires_grad_(), (bits + 0.4).requires_grad_()
    whole, found = quantise(v, low, high, leaf), quantise(v, low, high, soft)
    assert torch.equal(whole, found)
    assert torch.equal(*(torch.autograd.grad(out.sum(), b)[0] for out, b in ((whole, leaf), (found, soft))))


@pytest.mark.parametrize("bitwidth", [1, 6, 12, 16])
def test_codes_agree_with_values_in_single_precision(bitwidth: int) -> None:
    generator = torch.Generator().manual_seed(bitwidth)
    v = torch.rand(2000, 3, generator=generator) * 140 - 20
    low, high = torch.tensor([0.0, -3.7, 10.0]), torch.tensor([100.0, 96.1, 99.0])
    bits = torch.tensor([float(bitwidth)])
    q = codes(v, low, high, bits)
    top = 2**bitwidth - 1
    assert q.dtype == torch.int64
    assert q.min() == 0
    assert q.max() == top
    step = (high - low).double() / top
    error = (quantise(v, low, high, bits) - (low + q * step)).abs()
    u = (v.double() - low) / step
    tied = (u - u.floor() - 0.5).abs() < 1e-7 * 2 * top  # rounding of u in single precision decides there
    assert tied.float().mean() < 0.1
    assert error[~tied].max() < 2e-5  # pixels; worst seen 1e-5, single precision's at 100
    assert (error <= step + 2e-5).all()


def test_codes_do_not_leave_the_range() -> None:
    v = torch.tensor([[-1e30], [1e30], [0.0], [1.0]])
    for bits in (torch.tensor([6.0]), torch.tensor([[6.0], [7.0], [8.0], [9.0]])):
        q = codes(v, torch.tensor([0.0]), torch.tensor([1.0]), bits)
        top = (2 ** bits.expand(4, 1)[:, 0].long() - 1) if bits.ndim == 2 else torch.full((4,), 63)
        assert q[:, 0].tolist() == [0, top[1].item(), 0, top[3].item()]


def clusters() -> tuple[Tensor, Tensor]:
    """Points [80, 3] in eight tight, far apart clusters, and the cluster of each point."""
    generator = torch.Generator().manual_seed(4)
    centres = torch.tensor(list(itertools.product((-3.0, 3.0), repeat=3)))
    index = torch.arange(80) % 8
    return centres[index] + 0.2 * torch.randn(80, 3, generator=generator), index


def test_kmeans_finds_the_means_of_clusters() -> None:
    points, index = clusters()
    found = kmeans(points, 8, seed=0)
    assert torch.equal(found, kmeans(points, 8, seed=0))
    for k in range(8):
        assert (found - points[index == k].mean(0)).norm(dim=1).min() < 1e-5  # worst seen 8e-7


@pytest.mark.parametrize("points", [torch.zeros(1, 3), torch.ones(50, 3), torch.eye(3)], ids=("one", "equal", "three"))
def test_kmeans_of_few_different_points(points: Tensor) -> None:
    found = kmeans(points, 8, seed=0)
    assert found.shape == (8, 3)
    assert torch.cdist(points, found).amin(1).max() == 0


def codebook(colors: Tensor) -> ResidualCodebook:
    return ResidualCodebook(colors, stages=2, entries=8, decay=0.8, seed=0)


def random_colors(n: int) -> Tensor:
    return torch.randn(n, 3, generator=torch.Generator().manual_seed(n))


def test_assign_finds_the_nearest_of_all_pairs() -> None:
    colors = random_colors(400)
    book = codebook(colors)
    index = book.assign(colors)
    pairs = book.entries[0][:, None] + book.entries[1][None]
    nearest = torch.cdist(colors.double(), pairs.reshape(-1, 3).double()).amin(1)
    chosen = (colors.double() - pairs[index[:, 0], index[:, 1]].double()).norm(dim=1)
    assert (chosen - nearest).max() < 1e-6  # worst seen 3e-15; two pairs may be equally near in single precision
    assert torch.equal(book.lookup(index), pairs[index[:, 0], index[:, 1]])
    assert index.min() == 0
    assert index.max() == 7


def test_entries_follow_the_mean_with_the_decay() -> None:
    colors = random_colors(300)
    book = codebook(colors)
    before = book.entries.clone()
    index = torch.stack([torch.arange(300) % 7, torch.arange(300) % 5], 1)  # entry 7 and entries 5, 6, 7 stand idle
    book.update(colors, index)
    # The second stage follows what the first has left, which has moved.
    left = colors - before[1][index[:, 1]], colors - book.entries[0][index[:, 0]]
    for stage, used in ((0, 7), (1, 5)):
        for k in range(used):
            mean = left[stage][index[:, stage] == k].mean(0)
            expected = 0.8 * before[stage, k] + 0.2 * mean
            torch.testing.assert_close(book.entries[stage, k], expected, atol=1e-6, rtol=0)
        assert torch.equal(book.entries[stage, used:], before[stage, used:])


def test_long_tuning_does_not_diverge() -> None:
    """Codebooks and colours follow each other: the error of colours does not grow."""
    colors, book = random_colors(300), codebook(random_colors(300))
    errors = []
    for _ in range(300):
        index = book.assign(colors)
        errors.append((colors - book.lookup(index)).square().mean().item())
        book.update(colors, index)
    assert max(errors) < 1.01 * errors[0]
    assert errors[-1] < errors[0]


def test_a_file_is_as_good_as_the_best_step() -> None:
    """The last steps, at a rate that is far too high, are much worse."""
    pixels = photo()[:48, :64]
    settings = replace(PAPER, adaptive_bitwidth=False, lambda_g=0.0)
    start = place_by_structure(pixels.astype(np.float32) / 255, 60, settings.start, np.random.default_rng(0))
    tuner = Tuner(start, level_of(pixels), settings, None, 0)
    errors = [tuner.step(rate)[0] for rate in [1.0] * 40 + [40.0] * 5]
    drawn = draw(tuner.stream().scene())
    assert errors[-1] > 1.5 * min(errors)
    assert np.square((drawn.astype(float) - pixels) / 255).mean() < 1.02 * min(errors)  # rounded to 8 bits
