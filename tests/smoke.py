"""Whether an installed sgmethod works: python tests/smoke.py, by the Python that it is installed for.

Every golden file, and one by the command line, must come out with its pixels, and a picture is encoded, without any
extra.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
del sys.path[0]  # this folder, whose benchmarks are tests of those that are imported here
sys.path.append(str(ROOT))  # behind all else, so that sgmethod is the installed one

import sgmethod  # noqa: E402
from tests.native.harness.golden import GOLDEN, is_golden  # noqa: E402
from tests.support.data import golden_path  # noqa: E402


def main() -> None:
    assert Path(sgmethod.__file__).parent != ROOT / "sgmethod", "sgmethod is not installed"
    for name, data in GOLDEN.items():
        assert is_golden(name, sgmethod.decode(data)), f"{name} has other pixels"
    picture = sgmethod.decode(golden_path("v2-color.sg"))
    assert sgmethod.encode(picture, gaussians=20).stats.psnr > 15, "an encode is poor"
    assert "torch" not in sys.modules, "torch is imported"
    command = shutil.which("sgmethod", path=sysconfig.get_path("scripts"))
    assert command is not None, "the command line is missing"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "color.png"
        subprocess.run([command, "decode", str(golden_path("v2-color.sg")), str(path), "--quiet"], check=True)
        with Image.open(path) as opened:
            assert is_golden("v2-color", np.asarray(opened)), "the command line gives other pixels"
    print(
        f"sgmethod {version('sgmethod')}, Python {platform.python_version()}, {platform.platform()}:"
        f" {len(GOLDEN)} golden files have their pixels, and one by the command line"
    )


if __name__ == "__main__":
    main()
