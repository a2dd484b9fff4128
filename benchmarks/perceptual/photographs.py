"""Photographs that are not Kodak's, from Debian's packages: python -m benchmarks.perceptual.photographs FOLDER

FOLDER/measured gets those that are measured, FOLDER/tuning those on which constants of the codec were chosen. The
longer side becomes 768 pixels, so that no trace of their JPEG files is left. FOLDER/large gets files of 12 megapixels
and more as they are, for benchmarks.speed growth. Needs apt-get, dpkg-deb and the packages of Debian 12; licences stand
in each package's copyright file.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

PACKAGES = (
    "lomiri-wallpapers-16.04",
    "lomiri-wallpapers-20.04",
    "mate-backgrounds",
    "plasma-workspace-wallpapers",
    "ukui-wallpapers",
)
SIDE = 768  # pixels
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


def name_of(path: Path) -> str:
    """A wallpaper of Plasma's is a folder with one file for each size."""
    return (path.parents[2].name if path.parent.name == "images" else path.stem).lower()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    with tempfile.TemporaryDirectory() as there:
        subprocess.run(["apt-get", "--quiet", "download", *PACKAGES], check=True, cwd=there)
        for package in Path(there).glob("*.deb"):
            subprocess.run(["dpkg-deb", "--extract", package, there], check=True)
        found = {name_of(path): path for path in Path(there).rglob("*.jpg") if _is_whole(path)}
        for part, names in PICTURES.items():
            (folder / part).mkdir(parents=True, exist_ok=True)
            for name in names.split():
                picture = Image.open(found[name]).convert("RGB")
                scale = SIDE / max(picture.size)
                size = round(picture.width * scale), round(picture.height * scale)
                picture.resize(size, Image.Resampling.LANCZOS).save(folder / part / f"{name}.png")
        (folder / "large").mkdir(exist_ok=True)
        for name in LARGE:
            shutil.copy(found[name], folder / "large" / f"{name}.jpg")


def _is_whole(path: Path) -> bool:
    return path.parent.name != "images" or path.stem == "2560x1600"


if __name__ == "__main__":
    main()
