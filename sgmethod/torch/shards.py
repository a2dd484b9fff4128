"""Fitted data sets: Gaussians of any number of pictures in shards, which are tar files as webdataset reads them.

    000000000.npz    means, factors, colors; background, size (width, height), error
    000000000.cls    the picture's label, if it is a number; or 000000000.json

A folder of shards has a manifest with a line for each, and a run that was killed resumes at the shard where it ended.
"""

from __future__ import annotations

import io
import json
import os
import re
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer
from sgmethod.budget import MAX_GAUSSIANS
from sgmethod.errors import ImageError, SgError
from sgmethod.exchange.ply_and_npz import arrays_of
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.io.image import read_input
from sgmethod.many.manifest import Manifest, Row
from sgmethod.many.run import OnRow, Run, Tally, Task, caught, finish_locally
from sgmethod.scene import Pixels
from sgmethod.torch.devices import checked_device
from sgmethod.torch.exact import Exact, ExactFit
from sgmethod.torch.fitting import fit_pictures, pictures_of, task_of

MAX_IN_A_SHARD = 1_000_000
NAME = re.compile(r"((?:.*/)?[^./]+)\.([^/]*)")  # as webdataset reads it: a key, and the end after its first dot
Arrays = dict[str, np.ndarray]
Labelled = tuple[Pixels, tuple[str, bytes] | None]  # [H, W, 3]; a label as the end of a file's name and its content


class Pictures(Protocol):
    """A map-style data set."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Any: ...


def fit_many(
    dataset: Pictures,
    output_dir: str | os.PathLike[str],
    gaussians: AnyInt,
    *,
    shard: AnyInt = 1000,
    steps: AnyInt | None = None,
    quantum: AnyFloat | None = None,
    device: object = None,
    resume: bool = False,
    on_row: OnRow[Row] | None = None,
) -> Tally:
    """Fit Gaussians to every picture of a data set, into output_dir/000000.tar and so on, with a manifest.

    dataset: map-style; each item is a picture or a pair (picture, label). A picture is a tensor [3, H, W] as fit()
    takes it, or what encode() takes, of any size; a label is a whole number or a dict for JSON.
    shard: pictures in a file, which are in memory at the same time.
    gaussians, steps, quantum: as in fit(); device: where the work is done.
    resume: skip shards that the manifest has, if their files are there, and version, options and the data set's length
    are the same.
    on_row: called with each finished shard's line of the manifest, and with the run so far, which counts shards.

    A picture that cannot be fitted, such as one of fewer pixels than Gaussians, is left out of its shard. The shard's
    line names it, with its error, and a run that resumes makes that shard again. Raises BudgetError for wrong options,
    SgError for a manifest that cannot be written, and OSError if the folder cannot be created.
    """
    fit = task_of(gaussians, MAX_GAUSSIANS, steps, quantum)
    shard, where = checked_integer(shard, "pictures in a shard", 1, MAX_IN_A_SHARD), checked_device(device)
    folder, pictures = checked_path(output_dir), len(dataset)
    folder.mkdir(parents=True, exist_ok=True)
    make = partial(caught, partial(_written, dataset, fit, where, folder))
    asked = {"gaussians": gaussians, "steps": steps, "quantum": quantum}
    with Manifest(folder, {**asked, "shard": shard, "pictures": pictures}) as manifest:
        run = Run[Row](manifest, resume, -(-pictures // shard))
        return run.finish(finish_locally(make, run.rest(_tasks(pictures, shard)), 1), on_row)


def _tasks(pictures: int, shard: int) -> Iterator[Task[Row]]:
    for number, first in enumerate(range(0, pictures, shard)):
        yield Task(range(first, min(first + shard, pictures)), Row(f"{number:06}.tar", None))


def _written(dataset: Pictures, fit: ExactFit, device: torch.device, folder: Path, task: Task[Row]) -> Row:
    """Fit the pictures of a shard and write it; return its line of the manifest."""
    samples: dict[int, Labelled] = {}
    lost = []
    for index in task.picture:
        try:
            samples[index] = _sample(dataset[index], fit.gaussians)
        except (SgError, OSError) as error:
            lost.append(f"picture {index}: {error}")
    row = replace(task.row, notes=lost)
    if lost:
        row = replace(row, error=f"{len(lost)} of {len(task.picture)} pictures cannot be fitted; {lost[0]}")
    if not samples:
        return row
    fitted = fit_pictures([pixels for pixels, _ in samples.values()], fit, device)
    data = _archive(samples, fitted)
    write_atomically(folder / row.name, data)
    mean = float(np.mean([one.error for one in fitted]))
    return replace(row, bytes=len(data), figures={"pictures": len(fitted), "error": mean})


def _sample(item: Any, gaussians: int) -> Labelled:
    """Return an item's pixels and label. Raises SgError and OSError if this many Gaussians cannot be fitted to it."""
    picture, label = item if isinstance(item, tuple) else (item, None)
    pixels = pictures_of(picture[None])[0] if isinstance(picture, Tensor) else read_input(picture)
    height, width, _ = pixels.shape
    if height * width < gaussians:
        raise ImageError(f"{width} x {height} pixels are too few for {gaussians} Gaussians")
    if isinstance(label, Tensor | np.ndarray) and label.ndim == 0:
        label = label.item()
    if isinstance(label, Integral):
        return pixels, ("cls", str(int(label)).encode())
    if label is None:
        return pixels, None
    try:
        return pixels, ("json", json.dumps(dict(label)).encode())
    except (TypeError, ValueError) as error:
        raise SgError(f"a label must be a whole number or a dict for JSON, not {label!r}") from error


def _archive(samples: dict[int, Labelled], fitted: list[Exact]) -> bytes:
    """Write a tar file, the same bytes for the same Gaussians."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        for (index, (pixels, label)), one in zip(samples.items(), fitted, strict=True):
            found, npz = one.gaussians, io.BytesIO()
            np.savez(
                npz,
                means=found.means,
                factors=found.factors,
                colors=found.colors,
                background=np.array(one.background, np.float32) / 255,
                size=np.array(pixels.shape[1::-1]),
                error=np.array(one.error, np.float32),
            )
            for end, data in filter(None, (("npz", npz.getvalue()), label)):
                entry = tarfile.TarInfo(f"{index:09}.{end}")
                entry.size = len(data)
                archive.addfile(entry, io.BytesIO(data))
    return file.getvalue()


@dataclass(frozen=True)
class Sample:
    """A picture's Gaussians and label in a shard: first byte and size of each file, by the end of its name."""

    shard: Path
    parts: dict[str, tuple[int, int]]

    def arrays(self) -> Arrays:
        """Read the arrays of the Gaussians. Raises GaussiansError and OSError."""
        names = ("means", "factors", "colors", "background", "size")
        return arrays_of(self._part("npz"), names, f"{self.shard} has no Gaussians of fit_many()")

    def label(self) -> dict[str, Any]:
        """Read the label: "cls", a number, or "json"; nothing if there is none. Raises SgError and OSError."""
        try:
            return {name: json.loads(self._part(name)) for name in ("cls", "json") if name in self.parts}
        except (ValueError, RecursionError) as error:
            raise SgError(f"{self.shard} has a label that is not JSON") from error

    def _part(self, name: str) -> bytes:
        first, size = self.parts[name]
        with self.shard.open("rb") as file:  # anew each time, as a DataLoader's processes may not share it
            file.seek(first)
            return file.read(size)


def samples_of(path: str | os.PathLike[str]) -> list[Sample]:
    """Find the samples of a shard, or of all shards in a folder. Raises SgError and OSError."""
    place = checked_path(path)
    found: list[Sample] = []
    for shard in sorted(place.glob("*.tar")) if place.is_dir() else [place]:
        parts: dict[str, dict[str, tuple[int, int]]] = {}
        try:
            with tarfile.open(shard, "r:") as archive:
                for entry in archive:
                    if entry.isfile() and (name := NAME.fullmatch(entry.name)):
                        parts.setdefault(name[1], {})[name[2]] = entry.offset_data, entry.size
        except (tarfile.TarError, ValueError, OverflowError) as error:  # of sizes that are none
            raise SgError(f"{shard} is not a shard, which is a tar file without compression: {error}") from error
        found += [Sample(shard, each) for each in parts.values() if "npz" in each]
    if not found:
        raise SgError(f"{place} has no fitted pictures")
    return found
