"""The differentiable renderer as an operator of torch; tests/drawing has what it draws."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import sgmethod
from sgmethod.errors import GaussiansError, SgError, ViewError
from sgmethod.native import native
from sgmethod.scene import Gaussians
from sgmethod.torch import drawing, render
from sgmethod.torch.drawing import _draw, _draw_backward
from tests.backend.cases import scattered
from tests.definitions import drawing as definition

SIZE = (40, 35)
CUTOFF = native.CUTOFF_V2


def tensors(gaussians: Gaussians, dtype: torch.dtype = torch.float64) -> list[Tensor]:
    return [torch.from_numpy(values).to(dtype).requires_grad_() for values in gaussians.arrays]


def stacked(n: int, batch: int, dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """[batch, n, ...]."""
    each = [scattered(n, seed) for seed in range(batch)]
    all_values = zip(*(tensors(gaussians, dtype) for gaussians in each), strict=True)
    return [torch.stack(values).detach().requires_grad_() for values in all_values]


@pytest.mark.parametrize("pyramid", [True, False])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["kernels", "pairs"])
def test_either_precision_is_drawn_as_defined(dtype: torch.dtype, pyramid: bool) -> None:
    """Single precision by the kernels, double precision by the lists of pairs: tests/drawing has more of both."""
    found, wanted = tensors(scattered(25, 0), dtype), tensors(scattered(25, 0))
    draw = definition.render_pyramid if pyramid else definition.render
    image, exact = render(*found, SIZE, pyramid=pyramid), draw(*wanted, SIZE, CUTOFF)
    assert image.dtype == dtype
    assert (image - exact).abs().max() < 1e-5  # worst seen 1e-6
    gradients = [torch.autograd.grad(one.square().sum(), values) for one, values in ((image, found), (exact, wanted))]
    for one, other in zip(*gradients, strict=True):
        assert (one - other).abs().max() < 1e-5 * other.abs().max()  # worst seen 2.5e-6


def test_the_default_is_the_sum_of_the_gaussians() -> None:
    """Drawn on coarser levels, one of colour 1 is off by 3 of 255 levels, which fits of others' Gaussians would see."""
    factors = torch.tensor([[8.0, 0.0, 8.0]])
    image = render(torch.tensor([[20.0, 17.0]]), factors, torch.ones(1, 3), SIZE)
    y, x = torch.meshgrid(torch.arange(SIZE[1]) + 0.5, torch.arange(SIZE[0]) + 0.5, indexing="ij")
    sigma = ((x - 20) ** 2 + (y - 17) ** 2) / 128
    wanted = (torch.exp(-sigma) - math.exp(-CUTOFF)).clamp(min=0)
    assert (image - wanted).abs().max() < 1e-5  # worst seen below 1e-6
    on_levels = render(torch.tensor([[20.0, 17.0]]), factors, torch.ones(1, 3), SIZE, pyramid=True)
    assert 0.01 < (on_levels - wanted).abs().max() < 0.03


@pytest.mark.filterwarnings("ignore:.*torch.jit.script.*:DeprecationWarning")  # of torch's own forward mode
@pytest.mark.parametrize(("pyramid", "scale"), [*product((True, False), (1, 0.5))])
def test_gradcheck(pyramid: bool, scale: float) -> None:
    means, factors, colors = tensors(scattered(5, 1, (10, 8)))
    background = torch.rand(3, dtype=torch.float64, requires_grad=True)

    def drawn(*values: Tensor) -> Tensor:
        return render(*values[:3], (10, 8), values[3], scale, pyramid)

    values = means, factors, colors, background
    assert torch.autograd.gradcheck(drawn, values, fast_mode=True, check_forward_ad=True)


@pytest.mark.thorough
def test_it_is_an_operator_of_torch() -> None:
    values = stacked(6, 2)
    torch.library.opcheck(_draw, (*values, *SIZE, True))
    by_image = torch.rand(2, 3, *SIZE[::-1])
    torch.library.opcheck(_draw_backward, (*(one.detach() for one in values), by_image, True))


@pytest.mark.thorough
def test_it_compiles_whole() -> None:

    def loss(scale: float, *values: Tensor) -> Tensor:
        return render(*values, SIZE, 0.5, scale).square().mean()

    values = stacked(6, 2)
    compiled = torch.compile(loss, fullgraph=True, backend="aot_eager")
    for scale in (1.0, 1.5):
        gradients = [torch.autograd.grad(function(scale, *values), values) for function in (compiled, loss)]
        for one, other in zip(*gradients, strict=True):
            assert torch.equal(one, other)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_leading_dimensions(dtype: torch.dtype) -> None:
    means, factors, colors = stacked(6, 4, dtype)
    background = torch.rand(4, 3, dtype=dtype)
    each = [render(means[i], factors[i], colors[0], SIZE, background[i]) for i in range(4)]
    both = render(means, factors, colors[0], SIZE, background)  # one set of colours for all
    assert torch.equal(both, torch.stack(each))
    split = [values.reshape(2, 2, 6, -1) for values in (means, factors)]
    assert torch.equal(render(*split, colors[0], SIZE, background.reshape(2, 2, 3)).reshape(both.shape), both)
    assert render(means[:, :0], factors[:, :0], colors[:, :0], SIZE, 0.25).unique().tolist() == [0.25]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_any_layout_in_memory(dtype: torch.dtype) -> None:
    values = stacked(6, 2, dtype)
    turned = [one.detach().mT.contiguous().mT.requires_grad_() for one in values]
    assert not turned[0].is_contiguous()
    assert torch.equal(render(*values, SIZE), render(*turned, SIZE))
    gradients = [torch.autograd.grad(render(*v, SIZE).sum(), v) for v in (values, turned)]
    assert all(map(torch.equal, *gradients))


@pytest.mark.parametrize("scale", [0.37, 1.0, 2.5])
def test_it_draws_what_a_file_shows(scale: float) -> None:
    gaussians, background = scattered(25, 3), (0.2, 0.4, 0.6)
    data = sgmethod.pack(gaussians, *SIZE, quantum=0.02, background=background)
    file = sgmethod.open(data)
    means, factors, colors, below = sgmethod.torch.gaussians(file)
    assert below.tolist() == pytest.approx(background)
    image = render(means, factors, colors, file.size, below, scale, pyramid=True)
    levels = (255 * image.clamp(0, 1)).permute(1, 2, 0).numpy()
    assert np.abs(levels - file.pixels(scale)).max() < 0.501


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_autocast(compiled: bool, dtype: torch.dtype) -> None:
    """What a network gives then is drawn in single precision, beside parameters that are in it; gradients return."""
    means, factors, colors = stacked(6, 2)
    layer = torch.nn.Linear(3, 3)

    def drawn() -> tuple[Tensor, Tensor]:
        halves = layer(colors)
        return halves, render(means, factors, halves, SIZE, 0.5)

    with torch.autocast("cpu", dtype):
        halves, image = (torch.compile(drawn, backend="aot_eager", fullgraph=True) if compiled else drawn)()
    assert (halves.dtype, image.dtype) == (dtype, torch.float32)
    assert torch.equal(image, render(means, factors, halves.float(), SIZE, 0.5))
    image.sum().backward()
    assert layer.weight.grad is not None
    assert layer.weight.grad.any()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("place", range(3))
def test_a_fit_that_diverges_is_noticed(place: int, value: float) -> None:
    """Its picture has no such values. Padding is no trouble."""
    values = stacked(6, 2)
    with torch.no_grad():
        values[place][1, 4] = value
    with pytest.warns(RuntimeWarning, match="it has diverged") as caught:
        render(*values, SIZE)
    assert [warning.filename for warning in caught] == [__file__]
    render(*(torch.nn.functional.pad(one, (0, 0, 0, 3)) for one in stacked(6, 2)), SIZE)


NOT_DRAWN = {
    "padding": (0, [0, 0, 0], 0),
    "place": (np.nan, [1, 0, 1], 1),
    "infinite place": (np.inf, [1, 0, 1], 1),
    "l1": (5, [-1, 1, 2], 1),
    "l2": (5, [1, np.nan, 1], 1),
    "l3": (5, [2, 1, 0], 1),
    "colour": (5, [2, 1, 2], np.nan),
    "infinite colour": (5, [2, 1, 2], np.inf),
    "wide": (5, [1e200, 0, 1e200], 1),
    "narrow": (3.5, [1e-200, 0, 2], 1),
    "slanted": (3.5, [1e-90, 1e90, 1], 1),
}


@pytest.mark.parametrize("scale", [1, 0.5, 2])
@pytest.mark.parametrize("path", ["kernels", "tensors", "tensors in double precision"])
def test_what_is_no_gaussian_is_not_drawn(path: str, scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    dtype = torch.float64 if "double" in path else torch.float32
    if path == "tensors":
        monkeypatch.setattr(drawing, "_has_kernels", lambda _values: False)
    good, rows = tensors(scattered(3, 1), dtype), zip(*NOT_DRAWN.values(), strict=True)
    bad = [torch.tensor(row, dtype=torch.float64).to(dtype) for row in rows]
    bad[0], bad[2] = bad[0][:, None].expand(-1, 2), bad[2][:, None].expand(-1, 3)
    all_values = [torch.cat(both).detach().requires_grad_() for both in zip(good, bad, strict=True)]
    with pytest.warns(RuntimeWarning, match="not finite are not drawn"):
        image = render(*all_values, SIZE, 0.0, scale)
    assert torch.equal(image, render(*good, SIZE, 0.0, scale))
    for gradient in torch.autograd.grad(image.square().sum(), all_values):
        assert gradient[:3].isfinite().all()
        assert not gradient[3:].any()


ONE = torch.zeros(1, 2), torch.ones(1, 3), torch.ones(1, 3)


@pytest.mark.parametrize(
    ("values", "more", "error", "words"),
    [
        ((ONE[0], ONE[1], np.ones((1, 3))), {}, GaussiansError, "colors must be a tensor .*, not ndarray"),
        ((ONE[1], ONE[1], ONE[2]), {}, GaussiansError, r"means must be a tensor \[..., N, 2\], not \[1, 3\]"),
        ((ONE[0], ONE[1].double(), ONE[2]), {}, GaussiansError, "factors are torch.float64"),
        ((ONE[0].half(), ONE[1].half(), ONE[2].half()), {}, GaussiansError, "float32 or all float64"),
        ((ONE[0].half().to("meta"), ONE[1], ONE[2]), {}, GaussiansError, "float32 or all float64"),
        ((ONE[0], ONE[1].expand(2, 3), ONE[2]), {}, GaussiansError, "of as many Gaussians"),
        ((ONE[0].expand(2, 1, 2), ONE[1].expand(3, 1, 3), ONE[2]), {}, GaussiansError, "leading dimensions"),
        (ONE, {"size": (0, 4)}, ViewError, "a side must be a whole number from 1"),
        (ONE, {"size": (4, 4, 4)}, ViewError, "a size is width and height"),
        (ONE, {"scale": 100}, ViewError, "the scale must lie in"),
    ],
)
def test_wrong_arguments(values: Any, more: dict[str, Any], error: type[SgError], words: str) -> None:
    with pytest.raises(error, match=words):
        render(*values, **{"size": SIZE, **more})
