"""Rate and quality over a folder of pictures: real files, decoded again and measured.

    python -m benchmarks.rd --images FOLDER [--most N] [--pictures kodim05] [--profiles rd,paper]
                            [--bpp 0.15,0.25] [--effort N] [--tune psnr] [--baselines [NAME ...]]
                            [--equal] [--judges] [--weights FOLDER] [--seen-bpp 0.25]
    python -m benchmarks.rd --images FOLDER --quality 20,30,40,50,60,70 [--effort N] [--tune psnr] [--weights FOLDER]

One encode at a time. What the JSON already holds for the same code, machine and settings is not done again, so that
an interrupted run resumes where it stopped. Each file is the best within a rate in bits per pixel; where none is so
small, the smallest that its codec makes. Profile rd comes with each tuning. --baselines adds other codecs, set as
baselines.py says. At the end come means, and the BD-rates against AVIF: mean, standard error, least and most over
pictures, and the bits per pixel that were compared.

--equal: at equal bytes. The figures of other codecs, which have few qualities to choose from, are interpolated along
the logarithm of bytes, between the files on both sides of the rate; ours take no more than the rate. At the end come
the differences between ours and each of theirs: mean, and standard error clustered by the package that pictures come
from. This compares two codecs alone:

    python -m benchmarks.rd --images FOLDER --equal --bpp 0.25 --tune fidelity --baselines 'avif tune=ssimulacra2'

--quality: profile rd at one quantum for all pictures, as published means over pictures mostly are; they may only be
compared with such. --weights: the folder that benchmarks.perceptual.weights fills, for LPIPS and DISTS too, which take
longer than all else. --judges: Butteraugli and ColorVideoVDP, which chose nothing (perceptual/judges.py says what they
need).
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.arguments import numbers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.ms_ssim import ms_ssim
from benchmarks.perceptual.judges import Judges, judge_versions
from benchmarks.perceptual.networks import LPIPS_SIDE, Networks
from benchmarks.pictures import Pixels, add_options, named_in
from benchmarks.rd.baselines import BASELINES, USUAL, Baseline, versions
from benchmarks.rd.codecs import File, Sg
from benchmarks.rd.equal import FORMS, between, differences_table
from benchmarks.rd.report import QUALITIES, TITLES, Row, bd_rates, means
from benchmarks.tables import number, table
from sgmethod import info
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr, ssimulacra2
from sgmethod.profiles import DEFAULT_EFFORT, EFFORTS, PROFILE_NAMES, TUNES

Codec = Sg | Baseline
Metric = Callable[[Pixels, Pixels], dict[str, Any]]  # of a picture and its source, by field of a row
DECODES = 5  # the median of their times is reported


class Source(NamedTuple):
    """A picture, and the rate or quality to encode it at."""

    image: str
    pixels: Pixels
    aim: float


def measure(codec: Codec, image: str, pixels: Pixels, aim: float, metrics: Sequence[Metric], equal: bool) -> Row:
    """The row of a picture at a rate, of one file, or of the two on both sides of it."""
    made = codec.around(pixels, aim) if equal and isinstance(codec, Baseline) else [codec.best(pixels, aim)]
    found = [compared(codec, one, Source(image, pixels, aim), metrics) for one in made]
    return between(*found) if len(found) == 2 else found[0]


def compared(codec: Codec, made: File, source: Source, metrics: Sequence[Metric]) -> Row:
    """Write a file, read and decode it, compare. metrics: others that it takes part in."""
    image, pixels, aim = source
    times = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture"
        path.write_bytes(made.data)
        size = path.stat().st_size
        for _ in range(DECODES):
            began = time.perf_counter()
            decoded = codec.decode(path.read_bytes())
            times.append(1e3 * (time.perf_counter() - began))
    db = psnr(decoded, pixels)
    row = Row(
        codec=codec.name,
        max_bpp=aim,
        image=image,
        bytes=size,
        bpp=8 * size / (pixels.shape[0] * pixels.shape[1]),
        psnr=db if math.isfinite(db) else None,
        ms_ssim=ms_ssim(decoded, pixels),
        ssimulacra2=ssimulacra2(decoded, pixels),
        gaussians=info(made.data).gaussians if isinstance(codec, Sg) else None,
        encode_s=round(made.encode_s, 3),
        decode_ms=round(statistics.median(times), 3),
    )
    if isinstance(codec, Sg) and codec.profile == "rd":
        row = replace(row, effort=codec.effort)
        row = replace(row, max_bpp=None, quality=aim) if codec.one_quality else row
    if min(pixels.shape[:2]) >= LPIPS_SIDE:
        for metric in metrics:
            row = replace(row, **metric(decoded, pixels))
    return row


def codecs_of(options: argparse.Namespace) -> list[Codec]:
    """The codecs that are asked for."""
    tuned = [Sg("rd", name, effort=options.effort) for name in options.tune]
    if options.quality:
        return [replace(ours, one_quality=True) for ours in tuned]
    codecs: list[Codec] = []
    for name in options.profiles:
        codecs += tuned if name == "rd" else [Sg(name)]
    return [*codecs, *(baseline() for name, baseline in BASELINES.items() if name in options.baselines)]


def means_table(rows: Sequence[Row]) -> str:
    """A line for each codec and rate or quality: means over the pictures."""
    forms = {"images": "g", "bpp": ".3f", **{name: FORMS[name] for name in QUALITIES}}
    forms |= {"encode_s": ".2f", "decode_ms": ".1f"}
    lines = [
        [codec, f"{aim:g}", *(number(m[name], form) for name, form in forms.items())]
        for (codec, aim), m in means(rows).items()
    ]
    return table(" | ".join(["codec", "asked", *(TITLES.get(name, name) for name in forms)]), lines)


def checked(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options. Exits with one clear line for what makes no sense."""
    options = parser.parse_args()
    options.baselines = [] if options.baselines is None else options.baselines or [baseline.name for baseline in USUAL]
    if options.quality and options.baselines:
        parser.error("--quality is for profile rd alone, without --baselines")
    if options.baselines and not versions():
        parser.error("--baselines needs the extra: pip install -e '.[benchmark]'")
    return options


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=10**6)
    profiles = f"of {', '.join(PROFILE_NAMES)}; may be empty"
    parser.add_argument("--profiles", type=some_of(PROFILE_NAMES, "profile", none=True), default="rd", help=profiles)
    parser.add_argument("--bpp", type=numbers, default=[0.15, 0.25, 0.4], help="each an upper limit for every file")
    parser.add_argument("--quality", type=numbers, help="in place of --bpp: quanta, halved by each 16 points")
    parser.add_argument("--effort", type=int, choices=EFFORTS, default=DEFAULT_EFFORT, help="of profile rd")
    parser.add_argument("--tune", nargs="+", choices=TUNES, default=TUNES, help="of profile rd")
    parser.add_argument(
        "--baselines", nargs="*", choices=BASELINES, help="the usual ones, with one setting each, where none is named"
    )
    parser.add_argument("--equal", action="store_true", help="other codecs at exactly the rate, by interpolation")
    parser.add_argument("--judges", action="store_true", help="Butteraugli and ColorVideoVDP too")
    parser.add_argument("--weights", type=Path, help="folder of the networks' weights")
    parser.add_argument("--seen-bpp", type=numbers, help="of --bpp, those with the metrics of these two options; all")
    parser.add_argument("--out", type=Path, default=RUNS / "rd" / "kodak.json")
    options = checked(parser)
    settings: dict[str, Any] = {"codecs": versions() if options.baselines else []}
    settings |= {"seen": options.weights is not None, "seen_bpp": options.seen_bpp}
    if options.equal or options.judges:  # the rows of runs without them stay valid
        settings |= {"equal": options.equal, "judges": judge_versions() if options.judges else []}
    metrics: list[Metric] = [Networks(options.weights)] if options.weights else []
    metrics += [Judges()] if options.judges else []
    record = Record(options.out, "benchmarks.rd", settings)
    kept = {row.key for row in (Row(**kept) for kept in record.rows)}
    for path in named_in(options):
        pixels = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
        for codec in codecs_of(options):
            for aim in options.quality or options.bpp:
                if (codec.name, aim, path.name) not in kept:
                    asked = metrics if options.seen_bpp is None or aim in options.seen_bpp else []
                    record.add(asdict(measure(codec, path.name, pixels, aim, asked, options.equal)))
    rows = [Row(**row) for row in record.rows]
    print(f"\n{means_table(rows)}")
    if options.equal:
        ours, theirs = ([c.name for c in codecs_of(options) if isinstance(c, kind)] for kind in (Sg, Baseline))
        print(f"\n{differences_table(rows, ours, theirs)}")
    if rates := bd_rates(rows):
        lines = [[number(v, ".2f") if isinstance(v, float | None) else v for v in rate.values()] for rate in rates]
        print(f"\n{table(' | '.join(rates[0]), lines)}")


if __name__ == "__main__":
    main()
