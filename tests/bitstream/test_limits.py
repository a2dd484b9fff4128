"""The ends of what integers a payload may hold, which no encoder reaches, in both decoders; and hostile sizes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.document import rows
from tests.bitstream.plain_encoder_v2 import Wanted
from tests.bitstream.remake import small
from tests.support.data import ROOT

BRIGHT = 2**22, 0, 0


@pytest.mark.parametrize(
    ("within", "beyond"),
    [
        (Wanted(0, colour=BRIGHT), Wanted(0, colour=(2**22 + 1, 0, 0))),
        (Wanted(0, shape=(0, 8, 0)), Wanted(0, shape=(0, 9, 0))),
        (Wanted(0, shape=(0, 0, 2048)), Wanted(0, shape=(0, 0, 2049))),
        (
            Wanted(0, colour=(2**18, 0, 0), shape=(0, 2**21, 0)),
            Wanted(0, colour=(2**18, 0, 0), shape=(0, 2**21 + 1, 0)),
        ),
        (Wanted(0, colour=BRIGHT, shape=(0, 2**21, 0)), Wanted(0, colour=BRIGHT, shape=(0, 2**21 + 1, 0))),
        (Wanted(0, colour=BRIGHT, shape=(0, 7, 2**29)), Wanted(0, colour=BRIGHT, shape=(0, 7, 2**29 + 1))),
    ],
)
def test_limits_of_the_integers(within: Wanted, beyond: Wanted) -> None:
    data = small([within])
    found = rows(container.parse(data).gaussians())
    assert len(found) == 1
    assert found == plain.read(data).gaussians()
    data = small([beyond])
    with pytest.raises(BitstreamError, match=r"(shape|colour) is out of range"):
        container.parse(data).gaussians()
    with pytest.raises(plain.RefusedError, match=r"shape|colour"):
        plain.read(data).gaussians()


LARGE = {
    "a Gaussian in each class": small([Wanted(k, (3, 3)) for k in range(28, -5, -1)], 65_535),
    "many, and then few": small([Wanted(0, (30_000, 9))] * 3000 + [Wanted(-4, (65_000, 65_000))], 65_535),
    "more promised than there are": small([Wanted(0)], 65_535, promised=2**32 - 1),
}
SCRIPT = """
import json, re, sys
from sgmethod import BitstreamError
from sgmethod.bitstream import container
peak = lambda: int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
files = [container.parse(bytes.fromhex(line)) for line in sys.stdin]
before, found = peak(), []
for file in files:
    for prefix in (1, 1 - 1e-9):
        try:
            found.append(len(file.gaussians(prefix)))
        except BitstreamError as error:
            found.append(str(error))
print(json.dumps([peak() - before, *found]))
"""


def test_small_files_of_large_pictures_take_little_memory() -> None:
    """The map's blocks follow the Gaussians that there are, not the pixels, nor the Gaussians that are promised."""
    lines = "\n".join(data.hex() for data in LARGE.values())
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, cwd=ROOT, input=lines, capture_output=True, text=True, check=True, timeout=60)
    kilobytes, *found = json.loads(done.stdout)
    refused = "the file is damaged: more Gaussians than the data can hold"
    assert found == [33, 33, 3001, 3001, refused, 0]
    assert kilobytes < 10_000  # seen: 600
