"""Gaussians <-> PLY files of programs for 3D Gaussian splatting, and NumPy's .npz files.

|                    | npz                     | PLY, written                   | PLY, read                       |
|--------------------|-------------------------|--------------------------------|---------------------------------|
| means, in pixels   | kept                    | x, y; z is 0                   | x, y                            |
| factors, in pixels | kept                    | rot, and logarithms in scale   | of the covariance, flattened    |
|                    |                         |                                | along z                         |
| colours            | kept                    | f_dc, f_rest is 0; opacity     | f_dc times opacity              |
|                    |                         | is 1                           |                                 |
| order              | kept                    | kept                           | kept                            |
| end of a Gaussian  | at sigma = 3, as in     | none; the nearest endless      | at sigma = 3; the nearest such  |
|                    | .sg files               | Gaussian is written            | Gaussian is taken               |
| others             | size and background are | size and background are left   | f_rest and all other properties |
|                    | left out                | out                            | are left out                    |

Viewers of PLY files blend Gaussians by opacity, in order of depth, and do not add them up: they show places and shapes.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.errors import GaussiansError
from sgmethod.exchange.arrays import checked_gaussians
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.native import native
from sgmethod.numerics import quiet
from sgmethod.scene import Gaussians
from sgmethod.view import NO_CUTOFF, recut

PathLike = str | os.PathLike[str]
C0 = 0.28209479177387814  # the first spherical harmonic, in units of which f_dc is
OPAQUE = 20.0  # logit of an opacity that single precision takes for 1
FLAT = -16.0  # logarithm of a scale along z
NEEDED = ["x", "y", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"]
# All that programs of 3D splats expect, in their order: normals are unused, f_rest are harmonics of degrees 1 to 3.
NORMALS, HARMONICS = 3, 45
WRITTEN = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(HARMONICS))]
WRITTEN += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"}
TYPES |= {"double": "f8", "float64": "f8"}


def write_npz(path: PathLike, gaussians: Gaussians) -> None:
    """Write arrays means [N, 2], factors [N, 3] and colors [N, 3]. Raises GaussiansError and OSError."""
    own, file = checked_gaussians(gaussians), io.BytesIO()
    np.savez(file, means=own.means, factors=own.factors, colors=own.colors)
    write_atomically(checked_path(path), file.getvalue())


def read_npz(path: PathLike) -> Gaussians:
    """Read Gaussians from a file of write_npz(). Raises GaussiansError and OSError."""
    data, wrong = checked_path(path).read_bytes(), f"{path} is not an .npz file with means, factors and colors"
    return checked_gaussians(Gaussians(*arrays_of(data, ("means", "factors", "colors"), wrong).values()))


def arrays_of(data: bytes, names: Sequence[str], wrong: str) -> dict[str, NDArray[Any]]:
    """Read arrays of an .npz file by name. Raises GaussiansError with the message `wrong`."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except Exception as error:  # of NumPy, zipfile, zlib or tokenize, for a damaged file
        raise GaussiansError(wrong) from error


@quiet
def write_ply(path: PathLike, gaussians: Gaussians) -> None:
    """Write a binary PLY file in the format of 3D Gaussian splatting. Raises GaussiansError and OSError."""
    whole = recut(checked_gaussians(gaussians), native.CUTOFF_V2, NO_CUTOFF)
    l1, l2, l3 = whole.factors.astype(np.float64).T
    axes, scales, _ = np.linalg.svd(np.stack([l1, 0 * l1, l2, l3], 1).reshape(-1, 2, 2))
    half = np.arctan2(axes[:, 1, 0], axes[:, 0, 0]) / 2  # of the angle of the major axis
    zero = np.zeros_like(half)
    columns = [*whole.means.T, zero, *[zero] * NORMALS, *((whole.colors - 0.5) / C0).T, *[zero] * HARMONICS]
    columns += [zero + OPAQUE, *np.log(scales).T, zero + FLAT, np.cos(half), zero, zero, np.sin(half)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(half)}"]
    lines = [*header, *(f"property float {name}" for name in WRITTEN), "end_header", ""]
    write_atomically(checked_path(path), "\n".join(lines).encode() + np.stack(columns, 1).astype("<f4").tobytes())


@quiet  # the results are checked
def read_ply(path: PathLike) -> Gaussians:
    """Read Gaussians from a PLY file of 2D or 3D Gaussian splatting. Raises GaussiansError and OSError."""
    vertices = _vertices(checked_path(path).read_bytes(), str(path))

    def columns(names: str) -> NDArray[np.float64]:
        return np.stack([vertices[name] for name in names.split()], 1).astype(np.float64)

    solid = "scale_2" in (vertices.dtype.names or ())
    scales = np.exp(columns("scale_0 scale_1 scale_2" if solid else "scale_0 scale_1"))
    quaternions = columns("rot_0 rot_1 rot_2 rot_3")
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    along_x = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    along_y = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    axes = np.stack([np.stack(rows, 1)[:, : scales.shape[1]] * scales for rows in (along_x, along_y)], 1)
    colors = (0.5 + C0 * columns("f_dc_0 f_dc_1 f_dc_2")) / (1 + np.exp(-columns("opacity")))
    flat = Gaussians.from_covariances(columns("x y"), axes @ axes.swapaxes(1, 2), colors)
    return recut(checked_gaussians(flat), NO_CUTOFF)


def _vertices(data: bytes, name: str) -> NDArray[np.void]:
    """Read the vertices of a PLY file, with a field for each property."""
    # Lines end in \n or \r\n; only if the first ends in a lone \r do the others, as data may begin with \n by chance.
    header = re.match(rb"ply[ \t]*(?:\r?\n|(\r)).*?[\r\n]end_header[ \t]*(?(1)\r|\r?\n)", data, re.DOTALL)
    elements = list[tuple[str, int, list[list[str]]]]()
    try:
        if header is None:
            raise ValueError("another file")
        lines = [line.split() for line in header[0].decode("latin1").splitlines()]
        (order,) = (BYTE_ORDERS[words[1]] for words in lines if words[:1] == ["format"])
        for words in lines:
            if words[:1] == ["element"] and words[2].isdecimal():
                elements.append((words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                elements[-1][2].append(words[1:])
        place = [element for element, _, _ in elements].index("vertex")
        _, rows, properties = elements[place]
        kind = np.dtype([(field, order + TYPES[number]) for number, field in properties])
    except (ValueError, LookupError) as error:
        raise GaussiansError(f"{name} is not a PLY file of Gaussians") from error
    if missing := sorted(set(NEEDED) - set(kind.names or ())):
        raise GaussiansError(f"{name} has no property {missing[0]}, which a Gaussian needs")
    try:
        if order != "=":
            return np.frombuffer(data, kind, rows, _end(data, header.end(), order, elements[:place]))
        text = data[header.end() :].decode().splitlines()[sum(count for _, count, _ in elements[:place]) :]
        return np.array([tuple(text[row].split()) for row in range(rows)], kind)
    except (ValueError, OverflowError, LookupError) as error:
        raise GaussiansError(f"{name} is truncated, or damaged") from error


def _end(data: bytes, at: int, order: str, elements: list[tuple[str, int, list[list[str]]]]) -> int:
    """Find where binary elements end that begin at `at`. Properties are a type, or "list", two types, and a name."""
    for _, rows, properties in elements:
        types = [[np.dtype(order + TYPES[word]) for word in words[:-1] if word != "list"] for words in properties]
        if all(len(pair) == 1 for pair in types):
            at += rows * sum(kind.itemsize for (kind,) in types)
            continue
        for _ in range(rows):
            for *length, kind in types:
                items = 1
                if length:
                    items = max(int(np.frombuffer(data, length[0], 1, at)[0]), 0)
                    at += length[0].itemsize
                at += items * kind.itemsize
    return at
