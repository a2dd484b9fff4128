"""Whether the figures of the results come out again: some rows of each JSON, made anew by the command that it names.

    python -m benchmarks.again --images FOLDER [--weights FOLDER] [--rows 5] [--seed 0] [--results rd/kodak,needs]
                               [--seconds 600] [--folder FOLDER] [--out FILE]

Rows are drawn by chance from those that no clock decides: files, and the PSNR and other distances of fits with a fixed
number of steps. Bytes, Gaussians and figures are compared, times are not. Without --weights, LPIPS and DISTS are left
out. --seconds: at most for each JSON; what is not there by then, or comes from another command than the JSON's, counts
as not made. --images must be the folder that the results are of. --folder: with the JSONs; benchmarks/results. --out:
what came of it; what it already holds of the same code, machine and settings is not done again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.again.report import section
from benchmarks.arguments import some_of
from benchmarks.machine import RESULTS, RUNS, Record, found, origin, write_json
from tests.harness.data import ROOT

Row = dict[str, Any]
NAMES = (
    *("rd/kodak", "rd/effort", "rd/effort-quality", "rd/quality", "rd/paper", "rd/settings", "rd/patient"),
    *("convergence/kodak", "convergence/2-megapixels", "convergence/12-megapixels", "convergence/codecs"),
    *("needs", "representation", "ablation"),
)
# Methods that are fitted for so many seconds, by command.
TIMED = {
    "convergence": {"paper", "baseline", "plain Adam", "siren", "hash grid"},
    "representation": {"siren", "wire"},
}
OF_WEIGHTS = ("lpips", "dists")
COMPARED = ("bytes", "gaussians", "bpp", "psnr", "ms_ssim", "ssimulacra2", *OF_WEIGHTS)
TIMES = ("encode_s", "decode_ms", "seconds")
THREADS = "SG_THREADS"  # of a command alone: AVIF's files depend on their number
NEAR = 1e-5  # of a network's distance, whose sums depend on the threads that take part


def is_timed(name: str, row: Row) -> bool:
    """Whether a clock decides what comes out. name: of the JSON."""
    return row.get("method") in TIMED.get(name.partition("/")[0], ()) or str(row.get("setting", "")).endswith(" s")


def key_of(row: Row, rows: Sequence[Row]) -> Row:
    """What tells a row from all others: its first values, as many as that takes, but none that was measured."""
    key: Row = {}
    others = [other for other in rows if other is not row]
    for name, value in row.items():
        if name in COMPARED or name in TIMES:
            continue
        key[name] = value
        others = [other for other in others if name in other and other[name] == value]
        if not others:
            break
    return key


def arguments(command: str, images: Path, weights: Path | None) -> tuple[list[str], dict[str, str]]:
    """Module and arguments of a JSON's command with this machine's folders, and what it sets in the environment."""
    words = shlex.split(command)
    begin = words.index("python")
    settings = dict(word.split("=", 1) for word in words[:begin])
    words = words[begin + 2 :]
    for option, folder in (("--images", images), ("--weights", weights)):
        if option in words:
            k = words.index(option)
            words[k : k + 2] = [option, str(folder)] if folder else []
    return words, settings


def made_again(content: Row, drawn: Sequence[Row], options: argparse.Namespace) -> list[Row | None]:
    """The rows that the JSON's command makes in place of those drawn; None for one that it does not. Raises
    RuntimeError if it fails."""
    keys = [key_of(row, content["rows"]) for row in drawn]
    made: list[Row | None] = [None] * len(keys)
    words, settings = arguments(content["command"], options.images, options.weights)
    kept = dict(content["settings"])
    kept |= {name: False for name in ("seen", "lpips") if name in kept and not options.weights}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.json"
        others = [row for row in content["rows"] if row not in drawn]
        write_json(path, {**content, **origin(), "settings": kept, "rows": others})
        command = [sys.executable, "-m", *words, "--out", str(path)]
        environment = {name: value for name, value in os.environ.items() if name != THREADS}
        said = Path(folder) / "said"
        quiet: dict[str, Any] = {"env": environment | settings, "stdout": subprocess.DEVNULL}
        began = time.monotonic()
        with (
            said.open("w") as errors,
            subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=errors, **quiet) as process,
        ):
            try:
                while None in made and time.monotonic() - began < options.seconds:
                    status = process.poll()
                    written = json.loads(path.read_text())
                    if written["settings"] != kept:
                        now = {name: value for name, value in written["settings"].items() if value != kept.get(name)}
                        raise RuntimeError(f"other settings, or other versions of codecs: {now}")
                    made = [found(key, written["rows"]) for key in keys]
                    if status:
                        last = "".join(said.read_text().splitlines()[-1:])
                        raise RuntimeError(f"this failed with status {status}: {shlex.join(command)}: {last}")
                    if status == 0:
                        break
                    time.sleep(0.2)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)  # and what it has started
    return made


def compared(old: Row, new: Row, with_weights: bool) -> dict[str, list[float | None]]:
    """Each figure that is another, as it was and as it is."""
    different: dict[str, list[float | None]] = {}
    for name in COMPARED:
        was, now = old.get(name), new.get(name)
        if name in OF_WEIGHTS and not with_weights:
            continue
        near = name in OF_WEIGHTS and was and now and abs(now - was) <= NEAR * abs(was)
        if was != now and not near:
            different[name] = [was, now]
    return different


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="the folder that the results are of")
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--rows", type=int, default=5, help="of each JSON")
    parser.add_argument("--seed", type=int, default=0, help="of the draw")
    parser.add_argument("--results", type=some_of(NAMES, "result"), default=",".join(NAMES), help="JSONs")
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--folder", type=Path, default=RESULTS)
    parser.add_argument("--out", type=Path, default=RUNS / "again.json")
    options = parser.parse_args()
    if options.rows < 1:
        parser.error("--rows takes a number above 0")
    if missing := [name for name in options.results if not (options.folder / f"{name}.json").is_file()]:
        parser.error(f"{options.folder} has no {', '.join(missing)}")
    settings = {"rows": options.rows, "seed": options.seed, "seconds": options.seconds, "seen": bool(options.weights)}
    record = Record(options.out, "benchmarks.again", settings)
    failures = []
    for name in options.results:
        content = json.loads((options.folder / f"{name}.json").read_text())
        key = {"result": name, **{what: content[what] for what in ("commit", "date")}}
        if record.has(**key):
            continue
        rows = [row for row in content["rows"] if not is_timed(name, row)]
        drawn = random.Random(options.seed).sample(rows, min(options.rows, len(rows)))
        try:
            pairs = zip(drawn, made_again(content, drawn, options), strict=True)
        except RuntimeError as error:
            failures.append(f"{name}: {error}")
            continue
        both = [(old, compared(old, new, bool(options.weights))) for old, new in pairs if new]
        different = [{**key_of(old, content["rows"]), "figures": figures} for old, figures in both if figures]
        counts = {"of": len(rows), "drawn": len(drawn), "made": len(both)}
        record.add({**key, **counts, "different": different})
    print(section({**record.content, "rows": record.rows}).text())
    if failures:
        raise SystemExit("\n".join(failures))


if __name__ == "__main__":
    main()
