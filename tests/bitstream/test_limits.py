"""The ends of what integers a payload may hold, which no encoder reaches, in both decoders."""

from __future__ import annotations

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.plain_encoder_v2 import Wanted
from tests.bitstream.remake import small
from tests.bitstream.test_format_v1 import rows

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
