"""The ends of what integers a payload may hold, which no encoder reaches, in both decoders."""

from __future__ import annotations

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.make_refused import One
from tests.bitstream.plain_decoder_v2 import MOST_COLOUR, MOST_V
from tests.bitstream.test_format_v2 import rows

PER_STEP = 2**plain.MOST_EXPONENT  # steps of v and r are no finer than this, however long the colour is
MOST_R_STEPS = plain.MOST_R // 2


@pytest.mark.parametrize(
    ("within", "beyond"),
    [
        ((MOST_COLOUR, 0, 0), (MOST_COLOUR + 1, 0, 0)),
        ((1, MOST_V, 0), (1, MOST_V + 1, 0)),
        ((1, 0, MOST_R_STEPS), (1, 0, MOST_R_STEPS + 1)),
        ((PER_STEP, MOST_V * PER_STEP, 0), (PER_STEP, MOST_V * PER_STEP + 1, 0)),
        ((MOST_COLOUR, MOST_V * PER_STEP, 0), (MOST_COLOUR, MOST_V * PER_STEP + 1, 0)),
        ((MOST_COLOUR, 7, MOST_R_STEPS * PER_STEP), (MOST_COLOUR, 7, MOST_R_STEPS * PER_STEP + 1)),
    ],
)
def test_limits_of_the_integers(within: tuple[int, int, int], beyond: tuple[int, int, int]) -> None:
    y, v, r = within
    data = One(y=y, v=v, r=r).file
    found = rows(container.parse(data).gaussians())
    assert len(found) == 1
    assert found == plain.read(data).gaussians()
    y, v, r = beyond
    data = One(y=y, v=v, r=r).file
    with pytest.raises(BitstreamError, match=r"(shape|colour) is out of range"):
        container.parse(data).gaussians()
    with pytest.raises(plain.RefusedError, match=r"shape|colour"):
        plain.read(data).gaussians()
