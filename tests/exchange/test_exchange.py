"""Gaussians as arrays: out of files and back, to and from other programs' files, and what no file can hold."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import sgmethod
from sgmethod import BudgetError, Gaussians, GaussiansError, ImageError, SgError
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame
from sgmethod.exchange.packing import reaching_pixels
from sgmethod.exchange.ply_and_npz import C0, WRITTEN
from sgmethod.metrics import psnr
from sgmethod.native import native
from sgmethod.view import NO_CUTOFF, recut
from tests.backend.cases import scattered, single
from tests.definitions.drawing import render
from tests.support.data import golden_path
from tests.support.pictures import photo

SIZE = (64, 48)
SOME = scattered(20, 1, SIZE)


def within_reach(some: Gaussians) -> Gaussians:
    """The same, none so far beyond the picture that no file holds it."""
    some.means[:] = np.clip(some.means, -2, np.add(SIZE, 1.9))
    return some


PIXELS = photo()


def as_set(gaussians: Gaussians) -> set[bytes]:
    return {row.tobytes() for row in np.concatenate(gaussians.arrays, 1)}


def close(found: Gaussians, wanted: Gaussians) -> bool:
    """To single precision, of each array's largest value."""
    pairs = zip(found.arrays, wanted.arrays, strict=True)
    return all(np.abs(a - b).max() < 1e-5 * np.abs(b).max() for a, b in pairs)  # worst seen 2e-7


@pytest.mark.parametrize("name", ["color", "grey", "upright", "needles", "levels", "empty"])
def test_out_of_a_file_and_back(name: str) -> None:
    """The same Gaussians, but for those that no pixel sees, and any that are as narrow as can be: their size was
    clipped when they were decoded."""
    file = sgmethod.open(golden_path(f"v2-{name}.sg").read_bytes())
    found = file.gaussians()
    data = sgmethod.pack(found, *file.size, quantum=file.info.quantum, background=file.background)
    assert sgmethod.info(data).background == file.info.background
    for background in (np.array(file.background), torch.tensor(file.background, requires_grad=True)):
        assert sgmethod.pack(found, *file.size, quantum=file.info.quantum, background=background) == data
    again = sgmethod.open(data).gaussians()
    assert len(found) == file.info.gaussians
    found = reaching_pixels(found, file.size)
    assert len(again) == len(found)
    clipped = found.factors[:, ::2].min(1, initial=1) <= np.float32(0.3)
    assert as_set(found.rows(~clipped)) <= as_set(again)
    assert sgmethod.pack(again, *file.size, quantum=file.info.quantum, background=file.background) == data


@pytest.mark.parametrize("width", [1e-6, 0.05, 0.15, 0.2])
def test_a_gaussian_between_pixel_centres_is_left_out(width: float) -> None:
    """It touches no pixel; no file can hold one as small, and all others were refused with it."""
    speck, needle = (20.0, 20.0), (30.0, 20.9)  # the needle lies between two rows
    shapes = [(2, 0, 2), (width, 0, width), (4, 0, min(width, 0.1))]
    some = Gaussians(np.float32([(5, 5), speck, needle]), np.float32(shapes), np.full((3, 3), 0.5, np.float32))
    data = sgmethod.pack(some, *SIZE, quantum=0.1)
    alone = sgmethod.pack(some.rows(np.array([0])), *SIZE, quantum=0.1)
    assert data == alone


def test_what_reaches_a_pixel_is_what_the_decoder_draws() -> None:
    lot = np.random.default_rng(3)
    n = 400
    some = Gaussians(
        (lot.random((n, 2)) * 20 - 2).astype(np.float32),
        np.stack([lot.exponential(0.3, n), lot.normal(0, 0.5, n), lot.exponential(0.3, n)], 1).astype(np.float32)
        + 0.01,
        np.ones((n, 3), np.float32),
    )
    drawn = [
        bool(Kernels().residual(some.rows(np.array([k])), Frame(16, 16), np.zeros((3, 16, 16), np.int16)).any())
        for k in range(n)
    ]
    assert len(reaching_pixels(some, (16, 16))) == sum(drawn)
    assert 50 < sum(drawn) < n - 50
    assert as_set(reaching_pixels(some, (16, 16))) == as_set(some.rows(np.flatnonzero(drawn)))


def test_a_whole_gaussian_and_the_nearest_that_ends() -> None:
    one = [torch.tensor(values, dtype=torch.float64) for values in ([[50.0, 50.0]], [[9.0, 4.0, 6.0]], [[1.0, 1, 1]])]
    cut = recut(single(*one), NO_CUTOFF)
    whole = render(*one, (100, 100), NO_CUTOFF)[0]
    near = render(*(torch.from_numpy(values).double() for values in cut.arrays), (100, 100), native.CUTOFF_V2)[0]
    assert float(near.sum() / whole.sum()) == pytest.approx(1, abs=1e-4)
    assert float((near - whole).abs().max()) < 0.035  # as it was, 0.2 of its integral would be missing


def test_covariances() -> None:
    factors = SOME.factors.astype(np.float64)
    lower = np.stack([factors[:, 0], 0 * factors[:, 0], factors[:, 1], factors[:, 2]], 1).reshape(-1, 2, 2)
    # Products and sums of float32, fused or not: a few units of 6e-8.
    assert np.allclose(SOME.covariances, lower @ lower.mT, rtol=1e-5)
    assert close(Gaussians.from_covariances(SOME.means, lower @ lower.mT, SOME.colors), SOME)


def test_equal_gaussians() -> None:
    """By value, whatever the arrays are; NumPy's comparison of each element was an error."""
    tensors = Gaussians(*(torch.from_numpy(values).clone().requires_grad_() for values in SOME.arrays))
    moved, fewer = SOME.copy(), SOME.rows(np.arange(19))
    moved.means[3, 0] += 1
    assert SOME == SOME.copy() == tensors
    assert all(other != SOME for other in (moved, fewer, None, SOME.arrays))
    assert [moved, SOME.copy()].index(SOME) == 1
    assert SOME not in [moved, fewer]
    with pytest.raises(TypeError, match="unhashable type: 'Gaussians'"):
        hash(SOME)


def test_arrays_of_any_kind() -> None:
    wanted = sgmethod.pack(SOME, *SIZE, quantum=0.1)
    lists = Gaussians(*(values.tolist() for values in SOME.arrays))
    tensors = Gaussians(*(torch.from_numpy(values).double().requires_grad_() for values in SOME.arrays))
    assert sgmethod.pack(lists, *SIZE, quantum=0.1) == sgmethod.pack(tensors, *SIZE, quantum=0.1) == wanted
    halves = Gaussians(*(torch.from_numpy(values).bfloat16() for values in SOME.arrays))  # type: ignore[arg-type]
    rounded = Gaussians(*(values.float().numpy() for values in halves.arrays))  # type: ignore[attr-defined]
    assert halves == rounded
    assert sgmethod.pack(halves, *SIZE, quantum=0.1) == sgmethod.pack(rounded, *SIZE, quantum=0.1)


def test_a_budget_is_kept_and_used() -> None:
    many = within_reach(scattered(200, 2, SIZE))
    for bpp in (0.5, 2.0, 5.0):
        size = len(sgmethod.pack(many, *SIZE, bpp=bpp))
        assert 0.95 * bpp < 8 * size / (SIZE[0] * SIZE[1]) <= bpp


def test_a_picture_refines() -> None:
    file = sgmethod.open(sgmethod.encode(PIXELS, bpp=2, effort=1, tune="psnr").data)
    plain, refined = (
        sgmethod.pack(file.gaussians(), *file.size, bpp=1, background=file.background, image=image)
        for image in (None, PIXELS)
    )
    assert 0.9 < 8 * len(refined) / PIXELS[..., 0].size <= 1
    assert psnr(sgmethod.decode(refined), PIXELS) > psnr(sgmethod.decode(plain), PIXELS) + 0.3


def test_the_first_that_no_file_holds_is_named() -> None:
    some = within_reach(scattered(200, 2, SIZE))
    for place in (150, 41):
        some.means[place] = np.floor(some.means[place]) + 0.5  # else it might touch no pixel
        some.factors[place] = 3, 9e4, 3
        with pytest.raises(GaussiansError, match=re.escape(str(some.means[place].tolist()))):
            sgmethod.pack(some, *SIZE, quantum=1)


def one(mean: object = (30.5, 20.5), factor: object = (2, 0, 2), color: object = (1, 0, 0)) -> Gaussians:
    return Gaussians(*([values] for values in (mean, factor, color)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: sgmethod.pack(PIXELS, *SIZE, bpp=1), GaussiansError, "not ndarray"),
        (lambda: sgmethod.pack(one(mean=(1, 2, 3)), *SIZE, bpp=1), GaussiansError, r"not \[\(1, 3\), \(1, 3\),"),
        (lambda: sgmethod.pack(one(mean=("a", 2)), *SIZE, bpp=1), GaussiansError, "not an array of numbers"),
        (lambda: sgmethod.pack(one(color=(1, 0, np.nan)), *SIZE, bpp=1), GaussiansError, "0 has a value .* not finite"),
        (lambda: sgmethod.pack(one(factor=(2, 0, 0)), *SIZE, bpp=1), GaussiansError, "l1 and l3 must be positive"),
        (lambda: sgmethod.pack(one(factor=(2, 9e4, 2)), *SIZE, quantum=1), GaussiansError, "no file can hold"),
        (lambda: sgmethod.pack(one(factor=(1e4, 0, 1e-4)), *SIZE, quantum=1), GaussiansError, "8.9 million times"),
        (lambda: sgmethod.pack(one(mean=(10**400, 2)), *SIZE, quantum=1), GaussiansError, "not an array of numbers"),
        (lambda: sgmethod.pack(one(factor=(1e6, 0, 1e6)), *SIZE, bpp=1), GaussiansError, "0.21 to 19,500 pixels"),
        (lambda: sgmethod.pack(one(), 0, 5, bpp=1), GaussiansError, "a side must be a whole number from 1"),
        (lambda: sgmethod.pack(scattered(80, 1, (4, 4)), 4, 4, bpp=1), GaussiansError, "more than a file of 4 x 4"),
        (lambda: sgmethod.pack(one(), *SIZE, bpp=1, background=(0, 2, 0)), GaussiansError, "three numbers from 0 to 1"),
        (lambda: sgmethod.pack(one(), *SIZE, bpp=1, background="red"), GaussiansError, "not an array of numbers"),
        (lambda: sgmethod.pack(one(), *SIZE, bpp=1, image=PIXELS), ImageError, "has 128 x 96 pixels"),
        (lambda: sgmethod.pack(one(), *SIZE), BudgetError, "one of bpp and quantum"),
        (lambda: sgmethod.pack(one(), *SIZE, bpp=1, quantum=1), BudgetError, "one of bpp and quantum"),
        (lambda: sgmethod.pack(one(), *SIZE, quantum=0), BudgetError, "the quantum must be from"),
        (lambda: sgmethod.pack(one(), *SIZE, bpp=0.01), BudgetError, "fits into 3 bytes"),
    ],
)
def test_what_no_file_can_hold(call: Callable[[], object], error: type[SgError], words: str) -> None:
    with pytest.raises(error, match=words):
        call()


def test_what_is_written_is_read(tmp_path: Path) -> None:
    sgmethod.write_npz(tmp_path / "some.npz", SOME)
    found = sgmethod.read_npz(tmp_path / "some.npz")
    assert all(np.array_equal(a, b) for a, b in zip(found.arrays, SOME.arrays, strict=True))
    sgmethod.write_ply(tmp_path / "some.ply", SOME)
    assert close(sgmethod.read_ply(tmp_path / "some.ply"), SOME)  # PLY keeps them to single precision


HEADER = "ply\nformat {order} 1.0\ncomment of another program\nelement vertex 2\n"
PROPERTIES = ["double x", "float y", "float z", "uchar flag", *(f"float f_dc_{i}" for i in range(3)), "float f_rest_0"]
PROPERTIES += ["float opacity", *(f"float scale_{i}" for i in range(3)), *(f"float rot_{i}" for i in range(4))]
HEADER += (
    "".join(f"property {name}\n" for name in PROPERTIES) + "element face 0\nproperty list uchar int v\nend_header\n"
)
# The first lies on its side, with its third axis upright and its second in depth; opacity of a half.
QUARTER = [2**-0.5, 2**-0.5, 0, 0]  # about x
VERTICES = [
    [3.5, 4.5, 9, 7, 1 / C0, 0, 0, 5, 0, np.log(2), np.log(30), np.log(3), *QUARTER],
    [8.5, 1.5, 9, 7, 0, 0, 1 / C0, 5, 90, np.log(4), np.log(5), np.log(50), 2, 0, 0, 0],
]


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_ply_of_3d_splats_is_flattened(order: str, tmp_path: Path) -> None:
    kinds = {"double": "f8", "float": "f4", "uchar": "u1"}
    sign = {"binary_big_endian": ">"}.get(order, "<")
    dtype = np.dtype([(name, sign + kinds[kind]) for kind, name in map(str.split, PROPERTIES)])
    text = "".join(" ".join(map(repr, map(float, row))).replace(" 7.0 ", " 7 ") + "\n" for row in VERTICES)
    body = text.encode() if order == "ascii" else np.array([tuple(row) for row in VERTICES], dtype).tobytes()
    header = HEADER.format(order=order).replace("element v", "element camera 1\nproperty uchar lens\nelement v")
    (tmp_path / "splats.ply").write_bytes(header.encode() + (b"7\n" if order == "ascii" else b"7") + body)
    wanted = single([[3.5, 4.5], [8.5, 1.5]], [[2, 0, 3], [4, 0, 5]], [[0.75, 0.25, 0.25], [0.5, 0.5, 1.5]])
    assert np.allclose(sgmethod.read_ply(tmp_path / "splats.ply").factors[:, 1], 0, atol=1e-5)
    assert close(sgmethod.read_ply(tmp_path / "splats.ply"), recut(wanted, NO_CUTOFF))


PLAIN = ["ply", "format binary_little_endian 1.0", "element vertex 20"]
PLAIN += [*(f"property float {name}" for name in WRITTEN), "end_header"]


def with_element(*properties: str, rows: int = 2) -> list[str]:
    return [*PLAIN[:2], f"element camera {rows}", *(f"property {words}" for words in properties), *PLAIN[2:]]


@pytest.mark.parametrize(
    ("lines", "before", "newline"),
    [
        (["ply", "comment by hand", *PLAIN[1:]], b"", "\n"),
        ([*PLAIN[:9], "obj_info x", "comment property float opacity", "", *PLAIN[9:]], b"", "\n"),
        (["\t ".join(line.split(" ")) + " \t" for line in PLAIN], b"", "\n"),
        (PLAIN, b"", "\r\n"),
        (PLAIN, b"", "\r"),
        (with_element("float focal", "uchar lens"), bytes(10), "\n"),
        (with_element("list uchar short v", "float focal"), b"\2    ffff\0ffff", "\n"),
        (with_element(), b"", "\n"),
    ],
)
def test_headers_of_ply_as_its_rules_allow(lines: list[str], before: bytes, newline: str, tmp_path: Path) -> None:
    """Words are separated by blanks; comments and other elements may stand anywhere."""
    path = tmp_path / "some.ply"
    sgmethod.write_ply(path, SOME)
    body = path.read_bytes().partition(b"end_header\n")[2]
    assert len(body) == 20 * 62 * 4
    wanted = sgmethod.read_ply(path)
    path.write_bytes(newline.join([*lines, ""]).encode() + before + body)
    found = sgmethod.read_ply(path)
    assert all(np.array_equal(a, b) for a, b in zip(found.arrays, wanted.arrays, strict=True))


def test_ply_has_what_programs_of_3d_splats_expect(tmp_path: Path) -> None:
    """The reference implementation reads 45 values of f_rest, and viewers rely on the order."""
    sgmethod.write_ply(tmp_path / "some.ply", SOME)
    lines = (tmp_path / "some.ply").read_bytes().partition(b"end_header")[0].decode().splitlines()
    names = [line.split()[-1] for line in lines if line.startswith("property float ")]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{number}" for number in range(45)]
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a PLY file"),
        ("\n".join(PLAIN).replace("vertex 20", "vertex -1").encode() + b"\n" + bytes(248), "not a PLY file"),
        ("\n".join(with_element("list char int v", rows=10**30)).encode() + b"\n\xff\xff\xff", "truncated"),
        ("\n".join(with_element("list quad int v")).encode() + b"\n\0\0", "truncated, or damaged"),
        (b"ply\nproperty float x\nend_header\n", "not a PLY file"),
        (b"ply\nelement vertex 0\nend_header\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no property f_dc_0"),
        (HEADER.format(order="ascii").encode() + b"1 2\n", "truncated"),
        (HEADER.format(order="binary_little_endian").encode() + b"1 2\n", "truncated"),
        (HEADER.format(order="middle_endian").encode(), "not a PLY file"),
        (HEADER.format(order="ascii").replace("double", "quad").encode(), "not a PLY file"),
        (HEADER.format(order="ascii").replace("vertex 2", f"vertex {10**30}").encode(), "truncated"),
        (HEADER.format(order="ascii").encode() + (b"1 2 3 256" + b" 5" * 12 + b"\n") * 2, "truncated, or damaged"),
        (HEADER.format(order="binary_little_endian").encode() + b"\xff" * 150, "not finite"),
    ],
)
def test_damaged_ply(data: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(data)
    with pytest.raises(GaussiansError, match=words):
        sgmethod.read_ply(tmp_path / "bad.ply")


def test_damaged_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", means=SOME.means)
    np.savez(tmp_path / "pickle.npz", means=np.array([{}]), factors=1, colors=1)
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "array.npy", SOME.means)
    np.savez_compressed(tmp_path / "flipped.npz", **vars(SOME))
    data = bytearray((tmp_path / "flipped.npz").read_bytes())
    data[100] ^= 255
    (tmp_path / "flipped.npz").write_bytes(data)
    for name in ("other.npz", "pickle.npz", "text.npz", "empty.npz", "array.npy", "flipped.npz"):
        with pytest.raises(GaussiansError, match=r"not an \.npz file with means, factors and colors"):
            sgmethod.read_npz(tmp_path / name)
