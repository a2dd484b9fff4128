"""Profile rd's streams: the quantum's code, flags, prefixes, limits."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v2 import StreamV2
from tests.backend.cases import scattered, single
from tests.bitstream.plain_encoder_v2 import Wanted, write_payload
from tests.bitstream.remake import header_of
from tests.native.test_codec import rows
from tests.support.data import golden_path


def busy() -> StreamV2:
    """200 x 120 pixels in 700 Gaussians."""
    stream = container.parse(golden_path("v2-busy.sg").read_bytes())
    assert isinstance(stream, StreamV2)
    return stream


def short() -> StreamV2:
    return StreamV2.from_gaussians(scattered(300, 0, (120, 90)), (120, 90), 0.05, (0, 8, 255), False, is_short=True)


STREAMS = pytest.mark.parametrize("stream", [busy(), short()], ids=["busy", "short"])


@STREAMS
def test_prefix_of_a_stream(stream: StreamV2) -> None:
    whole = stream.gaussians()
    sizes = np.sqrt(whole.factors[:, 0] * whole.factors[:, 2])
    sizes = sizes[sizes > 1]  # of the smallest, one side may be at its least
    assert (sizes[1:] <= sizes[:-1] * math.sqrt(2) * 1.001).all()  # by classes, from the largest down
    for prefix in (1e-9, 0.2, 0.5, 0.999):
        part = stream.gaussians(prefix)
        assert np.array_equal(rows(part), rows(whole)[: len(part)])
        assert len(part) == pytest.approx(prefix * len(whole), abs=0.12 * len(whole))


def test_exact_bytes() -> None:
    """Values well within their steps, so that no machine's logarithm matters."""
    values = single(
        [[10.3, 20.4], [40.6, 5.2], [40.7, 5.3], [1.1, 46.2]],
        [[8.3, 1.2, 5.1], [2.2, 0, 2.3], [0.9, -0.4, 1.7], [0.4, 0.1, 0.5]],
        [[0.31, 0.22, 0.13], [-0.2, 0.1, 0.3], [0.5, 0.4, 0.4], [0.9, -0.9, 0.8]],
    )
    stream = StreamV2.from_gaussians(values, (64, 48), 0.1, (128, 64, 32), False)
    assert container.serialise(stream)[:10].hex() == "d3c20300b079a8040200"  # signature and header
    wanted = [
        Wanted(5, (3, 4), (32, 11, 0), (14, 8, 4), (9, 35)),
        Wanted(2, (22, 4), (3, -11, -1), (6, 0, 0), (2, 4)),
        Wanted(1, (22, 4), (16, 1, 1), (0, -5, -2), (11, 10)),
        Wanted(-2, (3, 48), (3, 1, 11), (1, -2, 2), (3, 3)),
    ]
    assert stream.payload == write_payload(header_of(stream), wanted)


def test_flags_of_a_stream() -> None:
    for grey, shear in itertools.product((False, True), (0, 1)):
        values = scattered(40, 0, (70, 50))
        values.factors[:, 1] *= shear
        stream = StreamV2.from_gaussians(values, (70, 50), 0.1, (9, 9, 9) if grey else (9, 8, 7), grey)
        assert (stream.grey, stream.upright) == (grey, not shear)
        assert container.parse(container.serialise(stream)) == stream


@STREAMS
def test_a_limit_of_gaussians(stream: StreamV2) -> None:
    count = len(stream.gaussians())
    assert len(stream.gaussians(limits=Limits(max_gaussians=count))) == count
    for prefix in (1.0, 0.9):
        most = len(stream.gaussians(prefix)) - 1
        with pytest.raises(BitstreamError, match=rf"limit of {most} Gaussians$"):
            stream.gaussians(prefix, Limits(max_gaussians=most))
