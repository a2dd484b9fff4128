"""Every renderer on every scene against the definition; the native ones also against each other, bit by bit."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.backend.protocol import Visibility
from sgmethod.native import native
from sgmethod.scene import FloatArray
from tests.backend.cases import VISIBILITIES, single, visibility
from tests.definitions import drawing
from tests.drawing.renderers import RENDERERS, Array, by_kernels, rasterised
from tests.drawing.scenes import EMPTY, NEEDLES, PYRAMIDS, SCENES, Scene, exact, exact_error, scattered, turned
from tests.support.node import answer_of

ISAS = range(native.best_isa() + 1)
BACKGROUND = (0.21, 0.71, 0.41)

each_renderer = pytest.mark.parametrize("renderer", RENDERERS)
each_scene = pytest.mark.parametrize("name", SCENES)


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    """Numpy, which interprets the kernels of a GPU, warns where values overflow; a GPU does not."""
    with np.errstate(all="ignore"):
        yield


def test_the_scenes_have_what_they_are_for() -> None:
    levels = {name: {drawing.level_of(*f) for f in SCENES[name].values.factors.tolist()} for name in PYRAMIDS}
    for name in ("pyramid", "pyramid of several tiles", "narrow pyramid"):
        assert levels[name] >= {0, 1, 2, 3}, name
    assert levels["all levels"] == set(range(drawing.MAX_LEVEL + 1))
    assert levels["thresholds"] == set(range(6))
    for name in SCENES:
        assert exact(name).picture.any() != (name in EMPTY), name


@each_renderer
@each_scene
def test_picture_and_gradients(name: str, renderer: str) -> None:
    draw, tolerance = RENDERERS[renderer]
    (picture, gradients), wanted = draw(SCENES[name]), exact(name)
    assert np.abs(picture - wanted.picture).max() < tolerance
    if name in NEEDLES:
        assert_needles(SCENES[name], gradients, wanted.by_picture)
    assert_alike(gradients, wanted.by_picture, tolerance)


def assert_alike(found: Sequence[Array], wanted: Sequence[Array], tolerance: float) -> None:
    for by, true in zip(found, wanted, strict=True):
        assert np.abs(by - true).max(initial=0) <= tolerance * np.abs(true).max(initial=0)


def in_frame(factors: FloatArray, by_mean: Array, by_factor: Array) -> NDArray[np.float64]:
    """Gradients as the optimiser takes them: by moves of the mean, and of the factor, along the factor's columns."""
    l1, l2, l3 = factors.astype(np.float64).T
    (x, y), (a, b, c) = by_mean.astype(np.float64).T, by_factor.astype(np.float64).T
    return np.stack([l1 * x + l2 * y, l3 * y, l1 * a + l2 * b, l3 * b, l3 * c], 1)


def assert_needles(scene: Scene, found: Sequence[Array], wanted: Sequence[Array]) -> None:
    """Gradients in parts of each needle's own; and, as the optimiser takes them, of the largest. There two numbers that
    are thousands of times as large cancel along the needle."""
    for by, true in zip(found, wanted, strict=True):
        error = np.linalg.norm(by - true, axis=1) / np.linalg.norm(true, axis=1)
        assert error.max() < 4e-4  # worst seen 1.2e-4
    own, true = (in_frame(scene.values.factors, *by[:2]) for by in (found, wanted))
    assert (np.abs(own - true).max(0) < 0.02 * np.abs(true).max(0)).all()  # worst seen 0.008


def squared_error(scene: Scene, isa: int, seen: Visibility | None = None) -> tuple[float, list[FloatArray]]:
    """The mean squared error from the target, and its gradients."""
    out = [np.full_like(array, np.nan) for array in scene.values.arrays]
    counts = () if seen is None else (seen.values, seen.by_eye, seen.coarse)
    return rasterised(scene, isa).squared_error(scene.values.colors, scene.target, *out, *counts), out


@pytest.mark.parametrize("kind", VISIBILITIES)
@pytest.mark.parametrize("name", PYRAMIDS)
def test_squared_error_and_gram_product(name: str, kind: str) -> None:
    scene = SCENES[name]
    seen = visibility(kind, 0, scene.size)
    wanted = exact_error(scene, seen)
    for isa in ISAS:
        error, gradients = squared_error(scene, isa, seen)
        assert error == pytest.approx(wanted.error, rel=3e-6)  # worst seen 6.6e-7
        if name in NEEDLES:
            assert_needles(scene, gradients, wanted.by_error)
        else:
            assert_alike(gradients, wanted.by_error, 1e-5)  # worst seen 4.3e-6
        gram = np.full_like(scene.values.colors, np.nan)
        rasterised(scene, isa).gram(scene.values.colors, gram, *(() if seen is None else (seen.values,)))
        assert_alike([gram], [wanted.gram], 1e-5)


@each_scene
def test_the_same_on_every_instruction_set_and_for_every_number_of_threads(
    name: str, set_threads: Callable[[int], None]
) -> None:
    """Pixels are; gradients, which may use fused arithmetic, for every number of threads."""
    scene = SCENES[name]
    pictures, pixels, gradients = [], [], {isa: set() for isa in ISAS}
    for threads in (1, 2, 5):
        set_threads(threads)
        for isa in ISAS:
            picture, by_picture = by_kernels(isa, scene)
            pictures.append(picture)
            pixels.append(np.full((*scene.size[::-1], 3), 77, np.uint8))
            rasterised(scene, isa).render_bytes(scene.values.colors, pixels[-1], BACKGROUND)
            error, by_error = squared_error(scene, isa)
            arrays = np.array(error), *by_error, *by_picture
            gradients[isa].add(b"".join(array.tobytes() for array in arrays))
    assert all(np.array_equal(other, pictures[0]) for other in pictures)
    assert all(np.array_equal(other, pixels[0]) for other in pixels)
    assert all(len(found) == 1 for found in gradients.values())
    shown = np.floor((pictures[0].transpose(1, 2, 0) + np.float32(BACKGROUND)).clip(0, 1) * 255 + 0.5)
    assert np.abs(shown - pixels[0]).max() <= 1  # the background is what the sum begins with


JAVASCRIPT = """
const { drawGaussians } = await import(`${src}/planes.js`);
const view = { x: 0, y: 0, left: 0, top: 0, sx: 1, sy: 1, dx: 0, dy: 0 };
console.log(JSON.stringify(given.map(([values, background, width, height]) =>
  Buffer.from(drawGaussians(Float32Array.from(values), background, { ...view, width, height })).toString("base64"))));
"""


def test_javascript() -> None:
    """Within what docs/format.md allows two decoders: one level, and seldom."""
    scenes, below = [SCENES[name] for name in PYRAMIDS], [255 * one for one in BACKGROUND]
    rows = [np.concatenate(scene.values.arrays, 1).ravel().tolist() for scene in scenes]
    answers = answer_of(JAVASCRIPT, [(row, below, *scene.size) for row, scene in zip(rows, scenes, strict=True)])
    for answer, name in zip(answers, PYRAMIDS, strict=True):
        picture = exact(name).picture.transpose(1, 2, 0) + np.array(BACKGROUND)
        levels = np.floor(255 * picture.clip(0, 1) + 0.5)
        found = np.frombuffer(base64.b64decode(answer), np.uint8).reshape(*levels.shape[:2], 4)[..., :3]
        assert np.abs(found - levels).max() <= 1
        assert np.mean(found != levels) < 0.001, name  # worst seen 1 in 3,600


def plain(scene: Scene) -> NDArray[np.float32]:
    """The same Gaussians without a pyramid."""
    picture, (means, factors, colors) = np.empty((3, *scene.size[::-1]), np.float32), scene.values.arrays
    native.Rasterization(means, factors, *scene.size, scene.cutoff).render(colors, picture)
    return picture


def test_narrow_gaussians_are_drawn_as_without_a_pyramid() -> None:
    scene = Scene(scattered(60, (83, 70), (0.4, 1.3), (0.4, 1.3), 1), (83, 70), pyramid=True)
    assert np.array_equal(by_kernels(native.best_isa(), scene)[0], plain(scene))


def test_a_pyramid_is_near_the_plain_sum() -> None:
    """At the narrow end of each level, in parts of the amplitude."""
    for level in range(1, 6):
        minor = drawing.NARROWEST * 2**level * 1.001
        for factor in ([minor, 0, minor], turned(5 * minor, minor)):
            scene = Scene(single([[40.3, 30.7]], [factor], [[1, 1, 1]]), (80, 60), pyramid=True)
            assert np.abs(by_kernels(0, scene)[0] - plain(scene)).max() < 0.03  # worst seen 0.021


@pytest.mark.parametrize("isa", ISAS)
def test_a_weight_ends_at_the_cut_off(isa: int) -> None:
    scale, cutoff = 4.0, native.MAX_CUTOFF
    one = single([[50.5, 50.5]], [[scale, 0, scale]], [[1, 1, 1]])
    row = by_kernels(isa, Scene(one, (101, 101), pyramid=False))[0][0, 50]
    reach = scale * np.sqrt(2 * cutoff)
    lit = np.flatnonzero(row) - 50
    assert lit.min() == -np.floor(reach)
    assert lit.max() == np.floor(reach)
    assert row[50] == pytest.approx(1 - np.exp(-cutoff), abs=1e-6)  # worst seen 0
