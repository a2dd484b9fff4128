"""A small set of measurements, in ten minutes at most, or what docs/results shows.

    python -m benchmarks [--full --images KODAK --photographs FOLDER --weights FOLDER] [--only rd,speed] [--report]

The small set takes the pictures of the tests and writes to build/bench. --full writes to benchmarks/results and goes on
where it was stopped, as long as code and machine are the same; --report, or python -m benchmarks.report, then makes the
documents. benchmarks/Dockerfile has all that this needs.
benchmarks.gpu is not in --full, as it needs a GPU.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.arguments import some_of
from benchmarks.machine import RESULTS, ROOT, RUNS
from benchmarks.rd.baselines import versions
from tests.support.data import PHOTOGRAPHS

KODAK = "--images {images}"
SEEN = f"{KODAK} --weights {{weights}}"
UNSEEN = "--images {photographs}/unseen --weights {weights} --seen-bpp 0.25"
RATES, QUALITIES = "--bpp 0.1,0.15,0.25,0.4", "--quality 20,30,40,50,60,70"
OTHERS = "'avif tune=psnr 10 bits' heic webp jpegxl jpeg"
# By size, of 0.7 to 4 megapixels: AVIF tuned for SSIMULACRA 2 takes up to a minute for one encode of the largest.
SEVEN = "dachshund,glass_bowls,pot_holder,parry_peak,canyon_river,aguas_claras,after_the_rain"
WHOLE = f"--images {{photographs}}/whole --pictures {SEVEN}"
EIGHT = "--images {photographs}/unseen --most 8 --megapixels 0.4"
# Of the photographs in LARGE, those that chose no constant.
LARGE = "broken_pcb,christmas_table,dahlia,fir_tip,lying_dog,peony,red_lake,two_samoyeds"
EIGHT_LARGE = f"--images {{photographs}}/large --most 99 --pictures {LARGE} --megapixels 4"
TWO_LARGE = "--images {photographs}/large --most 99 --pictures broken_pcb,dahlia --megapixels"
SMOOTH, TEXTURED = "hill_fog,yellow_sky,wet_petal", "canyon_river,two_samoyeds,pot_holder"
SIX = (
    f"--images {{photographs}}/unseen --most 99 --pictures {SMOOTH},{TEXTURED} --bpp 0.25 --tunes psnr,fidelity,visual"
)
BUT_AVIF = "--methods 'rd,rd visual,rd fidelity,paper,jpeg,webp,jpegxl,avif visual'"
BUT_UNTIL = "--methods 'rd,rd visual,rd fidelity,paper,jpeg,webp,jpegxl,avif,avif visual'"
BUT_PAPER = "--methods 'rd,rd visual,rd fidelity,jpeg,webp,jpegxl,avif,avif visual'"
AND_AVIF = "--methods avif"
ONE_CORE = "--few --limits 4 --cores 1 --methods 'rd,rd visual,rd fidelity,avif,avif visual,rd until,rd fidelity until'"
NO_BASELINES = "--methods 'rd,rd visual,paper'"
# The JSON of each command, and the command, or several that write to it.
SMALL = {
    "rd/kodak": f"rd {KODAK} --bpp 0.5",
    "convergence/0.4-megapixels": f"convergence {KODAK} --bpp 0.5 --most 1 --megapixels 0.1 --seconds 6 --limits 0.5 "
    "--paper-limits 2 --few",
    "stiff": "robustness stiff --pictures text,row-300x1,pixel-1x1 --only bpp",
    "stability": "robustness extremes --sets kernels,fits --generations 4",
    "kernels": f"speed kernels {KODAK} --steps 100 --rounds 10",
    "growth": f"speed growth {KODAK} --most 1 --megapixels 0.01 --at-megapixels 0.01 --at-bytes 300 --bytes 150,300",
    "ablation": f"ablation {KODAK} --most 1 --seeds 1 --fit-steps 200 --tune-steps 100",
    "service/load": "service load --seconds 5",
    "service/attacks": "service attacks --seconds 5 --only none,decode,idle",
}
FULL = {
    "rd/kodak": f"rd {SEEN} {RATES} --seen-bpp 0.25 --tune psnr visual",
    "rd/others": f"rd {SEEN} {RATES} --seen-bpp 0.25 --profiles '' --baselines",
    "rd/unseen": f"rd {UNSEEN} --bpp 0.25 --tune psnr visual --baselines {OTHERS} 'avif tune=iq 4:4:4' "
    "'avif tune=iq 10 bits' 'avif grain'",
    "rd/unseen-rates": f"rd {UNSEEN} --bpp 0.1,0.15,0.4 --tune psnr visual --baselines {OTHERS}",
    "rd/equal-768": "rd --images {photographs}/unseen --most 7 --bpp 0.25,0.5,1 --equal --judges --weights {weights} "
    "--seen-bpp 0.25,0.5,1 --tune psnr fidelity visual --baselines 'avif tune=psnr 10 bits' "
    "'avif tune=iq 4:4:4' 'avif tune=ssimulacra2' 'avif grain' jpegxl webp jpegli",
    "rd/equal-whole": f"rd {WHOLE} --equal --bpp 0.25,0.5,1 --tune fidelity --baselines 'avif tune=ssimulacra2'",
    "rd/equal-whole-eye": f"rd {WHOLE} --weights {{weights}} --seen-bpp 0.25,0.5,1 --equal --bpp 0.25,0.5,1 "
    "--tune visual --baselines 'avif tune=iq 4:4:4' 'avif grain'",
    "rd/equal-whole-psnr": f"rd {WHOLE} --equal --bpp 0.25,0.5,1 --tune psnr "
    "--baselines 'avif tune=psnr 10 bits' jpegxl webp jpegli",
    "rd/equal-kodak": f"rd {KODAK} --equal --bpp 0.25 --tune fidelity visual --baselines 'avif tune=ssimulacra2'",
    "rd/effort": f"rd {SEEN} --effort 9 --tune psnr --bpp 0.25",
    "rd/avif": f"rd {SEEN} --profiles '' --bpp 0.25 --baselines 'avif grain'",
    "rd/quality": f"rd {KODAK} --tune psnr {QUALITIES}",
    "previews/kodak": f"previews {SEEN}",
    "convergence/0.4-megapixels": f"convergence {EIGHT} --few {BUT_AVIF} --seconds 10 --paper-limits 3 "
    f"+ convergence {EIGHT} {AND_AVIF} --seconds 10",
    "convergence/4-megapixels": f"convergence {EIGHT_LARGE} --few --limits 1,4 --seconds 20 --paper-limits 5 "
    f"{BUT_UNTIL}",
    "convergence/12-megapixels": f"convergence {TWO_LARGE} 12 --few --limits 4 {BUT_PAPER}",
    "convergence/0.4-megapixels-1-core": f"convergence {EIGHT} {ONE_CORE}",
    "convergence/4-megapixels-1-core": f"convergence {TWO_LARGE} 4 {ONE_CORE}",
    "stiff": "robustness stiff --only bpp,psnr",
    "stability": "robustness extremes --sets kernels,fits",
    "strict": "robustness extremes --sets strict",
    "order": f"robustness order {SIX} --efforts 1,2,3,4,5,6,7,8,9 "
    "+ robustness order --images {photographs}/unseen --most 40",
    "mirrors": f"robustness order {SIX} --mirrors 4",
    "growth": "speed growth --images {photographs}/large --most 99 --pictures dahlia,peony,red_lake "
    "--megapixels 0.75,3,12 --bytes 500,2000,10000,50000 --repeats 1",
    "scenes": f"scenes {KODAK}",
    "sparse": "scenes --large {photographs}/large",
    "gains/crops": f"ablation gains {KODAK} --tables crops --most 6",
    "gains/numbers": f"ablation gains {KODAK} --tables numbers --most 12",
    "ablation": f"ablation {KODAK} --tables quantisation --most 12 --seeds 1",
    "positions": f"ablation {KODAK} --tables positions --most 8 --seeds 1",
    "bitwidths": f"ablation {KODAK} --tables bitwidths --most 6 --seeds 1",
    "service/load": "service load",
    "service/attacks": "service attacks",
    "service/chaos-sqlite": "service chaos --jobs 200 --seed 7",
    "service/chaos-postgresql": "service chaos --jobs 200 --seed 7 --database-url postgresql",
}
# The others are measured by one thread, as many side by side as there are cores: their times are those of a processor,
# or do not matter.
ON_ALL_CORES = ("convergence", "speed", "service")
COMMANDS = ("rd", "previews", "convergence", "speed", "ablation", "robustness", "service", "scenes")


def run(result: str, commands: list[list[str]], folder: Path) -> None:
    """Run the commands of a JSON, and print how long they took. If one fails, the next one runs all the same."""
    for words in commands:
        print(f"--- {shlex.join(words)}", flush=True)
        began = time.monotonic()
        command = [sys.executable, "-m", f"benchmarks.{words[0]}", *words[1:], "--out", str(folder / f"{result}.json")]
        threads = {} if words[0] in ON_ALL_CORES else {"SG_THREADS": "1", "OMP_NUM_THREADS": "1"}
        status = subprocess.run(command, cwd=ROOT, env={**os.environ, **threads}, check=False).returncode
        took = f"{result}: {time.monotonic() - began:.0f} s"
        print(f"{took}, failed with status {status}" if status else took, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS)
    parser.add_argument("--only", type=some_of(COMMANDS, "command"), default=",".join(COMMANDS), help="commands")
    parser.add_argument("--weights", type=Path, help="the folder that benchmarks.perceptual.weights fills")
    parser.add_argument("--photographs", type=Path, help="the folder that benchmarks.perceptual.photographs fills")
    parser.add_argument("--report", action="store_true", help="then make tables and plots from the results")
    options = parser.parse_args()
    lines = dict(FULL if options.full else SMALL)
    if not options.full:
        lines["rd/kodak"] += " --baselines" if versions() else ""
        lines["convergence/0.4-megapixels"] += "" if versions() else f" {NO_BASELINES}"
    lines = {name: line for name, line in lines.items() if line.split()[0] in options.only}
    if options.full and not versions():
        parser.error("--full needs the other codecs: pip install -e '.[benchmark]'")
    if any("{weights}" in line for line in lines.values()) and not options.weights:
        parser.error("--full needs --weights: python -m benchmarks.perceptual.weights FOLDER fetches them")
    if options.full and any(KODAK in line for line in lines.values()) and options.images == PHOTOGRAPHS:
        parser.error("--full needs --images: a folder with the 24 pictures of Kodak")
    if any("{photographs}" in line for line in lines.values()) and not options.photographs:
        parser.error("--full needs --photographs: python -m benchmarks.perceptual.photographs FOLDER fetches them")
    folders = {"images": options.images, "photographs": options.photographs, "weights": options.weights}
    folder = RESULTS if options.full else RUNS
    alone: list[tuple[str, list[list[str]], Path]] = []
    beside: list[tuple[str, list[list[str]], Path]] = []
    for name, line in lines.items():
        commands = [[word.format(**folders) for word in shlex.split(one)] for one in line.split(" + ")]
        (alone if commands[0][0] in ON_ALL_CORES else beside).append((name, commands, folder))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done in [pool.submit(run, *each) for each in beside]:
            done.result()
    for each in alone:
        run(*each)
    if options.report:
        subprocess.run([sys.executable, "-m", "benchmarks.report"], cwd=ROOT, check=False)


if __name__ == "__main__":
    main()
