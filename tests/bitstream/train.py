"""Trains the tables of the entropy coder: where its models begin, and the networks that say how likely a block is.

    python -m tests.bitstream.train --tuning FOLDER/tuning [--work build/coder] [--jobs 2] [--write]

The pictures are the photographs that benchmarks.perceptual.photographs puts into FOLDER/tuning, whole and two crops of
each at the middle of their sides, and six of skimage.data; none of them is measured anywhere. They are encoded at three
rates, and as previews of three sizes. The plain decoder of the tests says what every symbol and every block saw.
--write replaces sgmethod/native/rd/start_tables.h and density_net.h; without it, they go to the folder of work. Then
build the kernels, and run tests.bitstream.remake and sgmethod/javascript/tables.mjs: files coded with other tables are
no longer readable. As the fit prices by the tables so far, a second run gives slightly different ones.
"""

from __future__ import annotations

import argparse
import textwrap
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
import torch
from numpy.typing import NDArray
from PIL import Image

import sgmethod
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.remake import STARTS
from tests.support.data import ROOT

SKIMAGE = ("astronaut", "coffee", "chelsea", "rocket", "retina", "hubble_deep_field")
RATES, PREVIEW_BYTES = (0.1, 0.25, 0.4), (60, 200, 1000)
SIDE = 768
ROWS = 96  # of start tables
PRIOR = 8.0  # symbols of a table's mean row in each of its rows
BEGINNING = 16.0  # symbols that a model's start is worth: the n-th counts 16 / (16 + n)
MAP_UNITS, OWN_UNITS, GROUPS = 4, 3, 14
EPOCHS, BATCH, RATE = 20, 4096, 8e-3
Counts = dict[str, NDArray[np.float64]]  # by table: how often each symbol came in each row
STARTS_ARE = (
    "// Where the models of a stream begin: cumulative probabilities below symbols 1 to 15, in 1/256 (docs/format.md)."
)
NET_IS = "// The networks of density_map.h: logarithms in sixteenths of an octave, weights in 1/64 (docs/format.md)."
MADE_BY = "\n// Made by `python -m tests.bitstream.train`, which names the photographs."


def prepared(tuning: Path, folder: Path) -> list[Path]:
    """Write the pictures to a folder, unless they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(tuning.glob("*.png")):
        with Image.open(path) as opened:
            picture = opened.convert("RGB")
        picture.save(folder / path.name)
        width, height = picture.size[0] // 2, picture.size[1] // 2
        for name, x, y in (("left", 0, height // 2), ("right", width, height // 2)):
            picture.crop((x, y, x + width, y + height)).save(folder / f"{path.stem}-{name}.png")
    for name in SKIMAGE:
        scaled = Image.fromarray(getattr(skimage.data, name)())
        scaled.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
        scaled.save(folder / f"skimage-{name}.png")
    return sorted(folder.glob("*.png"))


def encoded(picture: Path, folder: Path) -> list[Path]:
    """Encode a picture at every rate, and as previews, unless the files are there."""
    budgets: list[dict[str, Any]] = [{"bpp": bpp} for bpp in RATES]
    files = []
    for budget in [*budgets, *({"bytes": size} for size in PREVIEW_BYTES)]:
        ((kind, value),) = budget.items()
        files.append(folder / f"{picture.stem} {kind}={value}.sg")
        if not files[-1].exists():
            sgmethod.encode(picture, tune="psnr", **budget).save(files[-1])
    return files


class _Watched(plain.Models):
    """Models that are found by their identity."""

    found: dict[int, tuple[str, int]]

    def __init__(self) -> None:
        super().__init__()
        for name in STARTS:
            models = getattr(self, name.replace(" ", "_"))
            rows = models if isinstance(models, list) else [models]
            self.found |= {id(model): (name, row) for row, model in enumerate(rows)}
        self.kept.append(self)

    kept: list[_Watched]  # or identities would come again


def seen_in(file: Path) -> tuple[Counts, NDArray[np.float32]]:
    """Symbols by table and row, and a row for each block: group, four features, three features, Gaussians, density."""
    counts = {name: np.zeros((len(plain.tables()[name]), 16)) for name in STARTS}
    blocks: list[plain.Blocks] = []
    _Watched.found, _Watched.kept = {}, []

    class Coder(plain.Coder):
        def symbol(self, which: int, *models: plain.Model) -> int:
            symbol = super().symbol(which, *models)
            for model in models:
                name, row = _Watched.found[id(model)]
                counts[name][row, symbol] += BEGINNING / (BEGINNING + model.seen - 1)
            return symbol

    class Blocks(plain.Blocks):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            blocks.append(self)

    before = plain.Models, plain.Coder, plain.Blocks
    plain.Models, plain.Coder, plain.Blocks = _Watched, Coder, Blocks  # type: ignore[misc,assignment]
    try:
        plain.read(file.read_bytes()).integers()
    finally:
        plain.Models, plain.Coder, plain.Blocks = before  # type: ignore[misc]
    rows = [features(one) for one in blocks if one.is_known]
    return counts, np.concatenate(rows) if rows else np.empty((0, 10), np.float32)


def features(blocks: plain.Blocks) -> NDArray[np.float32]:
    """What a class's blocks within the picture saw."""
    counts = blocks.counts[4:, 4:-4]
    padded = np.pad(counts, 4)
    height, width = counts.shape

    def at(dy: int, dx: int) -> NDArray[np.int64]:
        return padded[4 + dy : 4 + dy + height, 4 + dx : 4 + dx + width]

    p = np.minimum(2 * at(0, -1) + 2 * at(-1, 0) + at(-1, -1) + at(-1, 1), 63)
    above = sum(at(dy, dx) for dy in range(-4, 0) for dx in range(-4, 5))
    q = np.minimum(above + sum(at(0, dx) for dx in range(-4, 0)), 255)
    own = [
        np.vectorize(lambda k, by=by: plain.lg(256 * int(k) * blocks.inside // (by * blocks.n) + 77) - 128)(number)
        for number, by in ((p, 6), (q, 40))
    ]
    group, density = np.full(counts.shape, blocks.group), np.full(counts.shape, blocks.density)
    mean = np.full(counts.shape, blocks.n / blocks.inside)
    all_features = [group, *blocks.features(), *own, density, counts, mean]
    return np.stack([one[2:-2, 2:-2].ravel() for one in all_features], axis=1).astype(np.float32)


def started(counts: Counts) -> tuple[NDArray[np.int64], dict[str, list[int]]]:
    """Rows of start tables, and for each table's row the number of one of them."""
    wanted, weights, where = [], [], []
    for name, of_table in counts.items():
        mean = (of_table.sum(0) + 0.02) / (of_table.sum() + 0.32)
        for row, symbols in enumerate(of_table):
            wanted.append((symbols + PRIOR * mean) / (symbols.sum() + PRIOR))
            weights.append(symbols.sum())
            where.append((name, row))
    shares, weight = np.array(wanted), np.array(weights)
    shares = (shares + 0.0005) / (1 + 16 * 0.0005)
    order = np.argsort(shares @ np.arange(16), kind="stable")
    chosen = np.empty(len(order), np.intp)
    chosen[order] = np.arange(len(order)) * ROWS // len(order)
    for _ in range(60):  # k-means, where the distance is the bits that another row's shares cost
        common = np.full((ROWS, 16), 1e-3)
        np.add.at(common, chosen, shares * weight[:, None])
        common /= common.sum(1, keepdims=True)
        chosen = np.argmin(-shares @ np.log2(common).T, axis=1)
    used, chosen = np.unique(chosen, return_inverse=True)
    edges = np.clip(np.floor(256 * np.cumsum(common[used], axis=1)[:, :15] + 0.5), 0, 255).astype(np.int64)
    rows: dict[str, list[int]] = defaultdict(list)
    for (name, _), number in zip(where, chosen, strict=True):
        rows[name].append(int(number))
    return edges, rows


def trained(seen: NDArray[np.float32]) -> dict[str, NDArray[np.int64]]:
    """The networks' numbers, in integers: sums are logarithms of a block's Gaussians, in excess of the mean."""
    torch.manual_seed(0)
    data = torch.from_numpy(seen)
    group, of_map, of_own = data[:, 0].long(), data[:, 1:5] / 16, data[:, 5:8] / 16
    gaussians, mean = data[:, 8], data[:, 9]
    parts = []
    for inputs, units in ((of_map, MAP_UNITS), (of_own, OWN_UNITS)):
        bias, weights = torch.nn.Embedding(GROUPS, units), torch.nn.Linear(inputs.shape[1], units, bias=False)
        with torch.no_grad():
            bias.weight.mul_(0.3)
        parts.append((inputs.mean(0), inputs.std(0) + 1e-3, bias, weights, torch.nn.Linear(units, 1, bias=False)))
    base = torch.nn.Embedding(GROUPS, 1)
    with torch.no_grad():
        base.weight.zero_()
    modules = [base, *(module for part in parts for module in part[2:])]
    optimiser = torch.optim.Adam([p for module in modules for p in module.parameters()], RATE / 4)
    steps = EPOCHS * len(data) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps + 1)
    for _ in range(steps):
        some = torch.randint(0, len(data), (BATCH,))
        log = base(group[some])
        for inputs, (centre, spread, bias, weights, out) in zip((of_map, of_own), parts, strict=True):
            log = log + out(torch.relu(bias(group[some]) + weights((inputs[some] - centre) / spread)))
        log = log[:, 0].clamp(-8, 6)
        loss = 20 * (mean[some] * log.exp() - gaussians[some] * log).mean()  # of a Poisson distribution
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    numbers = {"map_base": 16 / np.log(2) * base.weight[:, 0]}
    for name, (centre, spread, bias, weights, out) in zip(("map", "own"), parts, strict=True):
        by = weights.weight / spread
        shift = bias.weight - (weights.weight * (centre / spread)).sum(1)
        largest = by.abs().amax(1)
        numbers |= {f"{name}_bias": 16 * shift / largest, f"{name}_weights": 64 * by / largest[:, None]}
        numbers[f"{name}_out"] = 64 / np.log(2) * out.weight[0] * largest
    return {name: np.rint(value.detach().numpy()).astype(np.int64) for name, value in numbers.items()}


def c_table(kind: str, name: str, values: NDArray[np.int64] | list[int]) -> str:
    """A constant of C++."""
    values = np.asarray(values)
    rows = [str(row.tolist()).strip("[]") for row in values]
    body = ", ".join(f"{{{row}}}" for row in rows) if values.ndim > 1 else ", ".join(map(str, values.tolist()))
    sizes = "".join(f"[{n}]" for n in values.shape)
    lines = textwrap.wrap(body, 116, initial_indent="    ", subsequent_indent="    ")
    return f"constexpr {kind} k{name}{sizes} = {{\n" + "\n".join(lines) + "};\n"


def headers(counts: Counts, seen: NDArray[np.float32]) -> dict[str, str]:
    """The two headers by name."""
    edges, rows = started(counts)
    starts = "".join(c_table("uint8_t", f"Start{STARTS[name]}", of_table) for name, of_table in rows.items())
    numbers = trained(seen)
    pascal = {name: "".join(part.capitalize() for part in name.split("_")) for name in numbers}
    net = "".join(c_table("int16_t", pascal[name], value) for name, value in numbers.items())
    begin = f"{MADE_BY}\n#pragma once\n\n#include <cstdint>\n\nnamespace sg {{\n\n"
    end = "\n}  // namespace sg\n"
    sizes = f"constexpr int kClassGroups = {GROUPS}, kMapUnits = {MAP_UNITS}, kOwnUnits = {OWN_UNITS};\n"
    common = c_table("uint8_t", "Starts", edges)
    return {
        "start_tables.h": f"{STARTS_ARE}{begin}{common}// Numbers of rows of kStarts.\n{starts}{end}",
        "density_net.h": f"{NET_IS}{begin}{sizes}{net}{end}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tuning", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "coder")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    pictures = prepared(options.tuning, options.work / "pictures")
    files_folder = options.work / "files"
    files_folder.mkdir(exist_ok=True)
    with ProcessPoolExecutor(options.jobs) as pool:
        files = sorted(file for some in pool.map(partial(encoded, folder=files_folder), pictures) for file in some)
        found = list(pool.map(seen_in, files))
    counts = {name: np.sum([one[name] for one, _ in found], axis=0) for name in STARTS}
    seen = np.concatenate([rows for _, rows in found])
    print(f"{len(files)} files, {counts['distance'].sum():,.0f} Gaussians, {len(seen):,} blocks", flush=True)
    folder = ROOT / "sgmethod" / "native" / "rd" if options.write else options.work
    for name, text in headers(counts, seen).items():
        (folder / name).write_text(text)
        print(folder / name)


if __name__ == "__main__":
    main()
