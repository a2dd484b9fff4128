"""The ends of what integers a payload may hold, which no encoder reaches, in both decoders."""

from __future__ import annotations

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from tests.bitstream import plain_decoder_v2 as plain
from tests.bitstream.test_format_v1 import rows


@pytest.mark.parametrize(
    ("within", "beyond"),
    [  # files of one Gaussian; y, v and r of both
        (
            "d3c28904203ca8113e001c60e22d0100000600000000009f",
            "d3c28904203ca8113e001c60e22d03000006000000000019",
        ),  # (4194304, 0, 0), (4194305, 0, 0)
        ("d3c28904203c0c8b7b021cc078a100cf", "d3c28904203c0c8b7b021cc078a10159"),  # (1, 8, 0), (1, 9, 0)
        (
            "d3c28904203ce48e11001cc0cc820b00000043",
            "d3c28904203ce48e11001cc0cc822b0000007d",
        ),  # (1, 0, 2048), (1, 0, 2049)
        (
            "d3c28904203c698f6a001c20c42b0100e00a00000000000000b4",
            "d3c28904203c698f6a001c20c42b0100e01a000000000000009f",
        ),  # (262144, 2097152, 0), (262144, 2097153, 0)
        (
            "d3c28904203c698f6a001c60c42b010000ae000000000000000089",
            "d3c28904203c698f6a001c60c42b010000ae010000000000000017",
        ),  # (4194304, 2097152, 0), (4194304, 2097153, 0)
        (
            "d3c28904203c1d0df6011c601612010000ee0000002000000000000056",
            "d3c28904203c1d0df6011c601612010000ee0100002000000000000068",
        ),  # (4194304, 7, 536870912), (4194304, 7, 536870913)
    ],
)
def test_limits_of_the_integers(within: str, beyond: str) -> None:
    data = bytes.fromhex(within)
    found = rows(container.parse(data).gaussians())
    assert len(found) == 1
    assert found == plain.read(data).gaussians()
    data = bytes.fromhex(beyond)
    with pytest.raises(BitstreamError, match=r"(shape|colour) is out of range"):
        container.parse(data).gaussians()
    with pytest.raises(plain.RefusedError, match=r"shape|colour"):
        plain.read(data).gaussians()
