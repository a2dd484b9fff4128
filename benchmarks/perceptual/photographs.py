"""Photographs that are not Kodak's, from Debian's packages: python -m benchmarks.perceptual.photographs FOLDER

FOLDER/unseen gets those of unseen.tsv, which chose no constant of the codec and decided on none of its features: the
headline rests on them. FOLDER/measured gets photographs that decided whether features stay, FOLDER/tuning those on
which constants were chosen. The longer side becomes 768 pixels, which removes most artefacts of their JPEG files.
FOLDER/whole gets the photographs of unseen.tsv as people have them, with at most 4 megapixels.
FOLDER/large gets files of 12 megapixels and more as they are, for speed. Needs apt-get, dpkg-deb and the packages of
Debian 12; licences stand in unseen.tsv and in each package's copyright file.
"""

from __future__ import annotations

import argparse
import csv
import math
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from PIL import Image, ImageOps

PACKAGES = (
    "lomiri-wallpapers-16.04",
    "lomiri-wallpapers-20.04",
    "mate-backgrounds",
    "plasma-workspace-wallpapers",
    "ukui-wallpapers",
)
SIDE = 768  # pixels
WHOLE_PIXELS = 4e6
PICTURES = {
    "measured": """aqua blinds bridge_by_sander_klootwijk bythewater coldripple colorfulcups darkesthour
        free_by_peter_nerlich freshflower garden greentock_by_peter_nerlich grey kite life_by_aitzol_berasategi
        onestandsout picosdeeuropa_by_aitzol_berasategi picture_0b_by_freespace raindrops storm
        sunset_by_aitzol_berasategi twowings wine_by_jakkub_mede wood yellowflower""",
    "tuning": """aitzgorri_by_aitzol_berasategi dragonfly_by_bolly dune eveningglow fallenleaf
        friends_by_aitzol_berasategi greenmeadow kleiber_by_lukas_baubkus ladybird path picture_1a_by_freespace
        seeding_by_clements_engelhardt""",
}
LARGE = ("dragonfly_by_bolly", "kleiber_by_lukas_baubkus", "sunset_by_aitzol_berasategi")
LARGE_PIXELS = 12e6
UNSEEN = Path(__file__).with_name("unseen.tsv")


@cache
def packages() -> dict[str, str]:
    """The package of each photograph in unseen.tsv."""
    with UNSEEN.open(newline="") as file:
        return {row["name"]: row["package"] for row in csv.DictReader(file, delimiter="\t")}


def grouped(images: Iterable[str]) -> list[str]:
    """What pictures may have in common: the package that brings them, or nothing but themselves."""
    return [packages().get(Path(image).stem, image) for image in images]


def name_of(path: Path) -> str:
    """A wallpaper of Plasma's is a folder with one file for each size."""
    return (path.parents[2].name if path.parent.name == "images" else path.stem).lower()


def reduced(source: Path, target: Path, max_pixels: float | None = None) -> None:
    """Write a photograph as PNG, upright and with a longer side of SIDE pixels, or with at most that many pixels."""
    picture = ImageOps.exif_transpose(Image.open(source)).convert("RGB")
    scale = min(1, math.sqrt(max_pixels / math.prod(picture.size))) if max_pixels else SIDE / max(picture.size)
    target.parent.mkdir(parents=True, exist_ok=True)
    size = round(picture.width * scale), round(picture.height * scale)
    (picture if scale == 1 else picture.resize(size, Image.Resampling.LANCZOS)).save(target)


def unpacked(package: str, into: Path) -> Path:
    """Fetch a package of Debian, and return the folder with its files."""
    folder = into / package
    folder.mkdir(exist_ok=True)
    subprocess.run(["apt-get", "--quiet", "download", package], check=True, cwd=into)
    (file,) = into.glob(f"{package}_*.deb")
    subprocess.run(["dpkg-deb", "--extract", file, folder], check=True)
    file.unlink()
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    large = folder / "large"
    large.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as there:
        folders = [unpacked(package, Path(there)) for package in PACKAGES]
        found = {name_of(path): path for one in folders for path in one.rglob("*.jpg") if _is_whole(path)}
        for part, names in PICTURES.items():
            for name in names.split():
                reduced(found[name], folder / part / f"{name}.png")
        for name in LARGE:
            shutil.copy(found[name], large / f"{name}.jpg")
        rows = [*csv.DictReader(UNSEEN.open(), delimiter="\t")]
        for package in dict.fromkeys(row["package"] for row in rows):
            files = unpacked(package, Path(there))
            for row in (row for row in rows if row["package"] == package):
                reduced(files / row["file"], folder / "unseen" / f"{row['name']}.png")
                reduced(files / row["file"], folder / "whole" / f"{row['name']}.png", WHOLE_PIXELS)
                if math.prod(Image.open(files / row["file"]).size) >= LARGE_PIXELS:
                    shutil.copy(files / row["file"], large / f"{row['name']}.jpg")
            shutil.rmtree(files)


def _is_whole(path: Path) -> bool:
    return path.parent.name != "images" or path.stem == "2560x1600"


if __name__ == "__main__":
    main()
