"""Profile rd's streams, versions 3 and 4: the header, the quantum's code, prefixes, limits, what is refused."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from sgmethod.bitstream.payload import HEADER_BYTES, MAX_QUANTUM, MIN_QUANTUM, quantum_code, quantum_of
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v3 import StreamV3
from sgmethod.bitstream.v4 import StreamV4
from tests.harness.data import golden, golden_path, with_checksum
from tests.native.test_codec import gaussians, rows, scattered


def of_version_3() -> StreamV3:
    """200 x 120 pixels in some 700 Gaussians."""
    stream = container.parse(golden_path("v3-large/busy.sg").read_bytes())
    assert isinstance(stream, StreamV3)
    return stream


def of_version_4() -> StreamV4:
    return StreamV4.of(scattered(300, (120, 90)), (120, 90), 0.05, (1, 2, 3), False)


STREAMS = pytest.mark.parametrize("stream", [of_version_3(), of_version_4()], ids=["v3", "v4"])


@STREAMS
def test_prefix_of_a_stream(stream: StreamV3 | StreamV4) -> None:
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
    values = gaussians(
        [[10.3, 20.4], [40.6, 5.2], [40.7, 5.3], [1.1, 46.2]],
        [[8.3, 1.2, 5.1], [2.2, 0, 2.3], [0.9, -0.4, 1.7], [0.4, 0.1, 0.5]],
        [[0.31, 0.22, 0.13], [-0.2, 0.1, 0.3], [0.5, 0.4, 0.4], [0.9, -0.9, 0.8]],
    )
    data = container.serialise(StreamV4.of(values, (64, 48), 0.1, (128, 64, 32), False))
    assert data[:4] == b"SGM\4"
    assert data[4:].hex() == (
        "7110ab470000400030089a8040208e9017000301dc0ad751397a60781a69eb88b79eb6ce06488ff08316fa585a0a4fe01903"
    )


@pytest.mark.parametrize("quantum", [1e-9, MIN_QUANTUM, 0.0123, 0.1, 0.999, 1.0, 1.9999, 3.3, MAX_QUANTUM, 1e9])
def test_quantum_round_trip(quantum: float) -> None:
    code = quantum_code(quantum)
    assert quantum_code(quantum_of(code)) == code
    clamped = min(max(quantum, MIN_QUANTUM), MAX_QUANTUM)
    assert quantum_of(code) == pytest.approx(clamped, rel=1 / 511)


def test_quantum_is_monotone() -> None:
    found = [quantum_of(quantum_code(q)) for q in np.geomspace(MIN_QUANTUM / 2, 2 * MAX_QUANTUM, 20_000)]
    assert found == sorted(found)
    assert len(set(found)) == 14 * 256 + 1
    assert all(quantum_code(q) == code for code in (0, *range(256, 3840)) for q in [quantum_of(code)])


def test_flags_of_a_stream() -> None:
    for grey, shear in itertools.product((False, True), (0, 1)):
        values = scattered(40, (70, 50))
        values.factors[:, 1] *= shear
        stream = StreamV4.of(values, (70, 50), 0.1, (9, 8, 7), grey)
        assert (stream.grey, stream.upright) == (grey, not shear)
        assert container.parse(container.serialise(stream)) == stream


@pytest.mark.parametrize("data", [*golden(3).values(), *golden(4).values()])
def test_stream_round_trip(data: bytes) -> None:
    stream = container.parse(data)
    assert container.serialise(stream) == data
    assert sum(container.info(data).bits.values()) == 8 * len(data)


@STREAMS
@pytest.mark.parametrize(
    ("at", "value", "why"),
    [
        (4, b"\0\0\0\0", "checksum"),
        (8, b"\x10", "flags is 16"),
        (9, b"\0\0", "width is 0"),
        (11, b"\0\0", "height is 0"),
        (13, b"\0\1", "quantum is 1"),
        (13, b"\x0f\0", "quantum is 3840"),
        (18, b"\0\0\0\0", "begins"),
    ],
)
def test_refused_headers(at: int, value: bytes, why: str, stream: StreamV3 | StreamV4) -> None:
    data = container.serialise(stream)
    data = data[:at] + value + data[at + len(value) :]
    with pytest.raises(BitstreamError, match=why):
        container.parse(data if at == 4 else with_checksum(data)).gaussians()


def test_version_3_has_no_texture() -> None:
    data = container.serialise(of_version_3())
    with pytest.raises(BitstreamError, match="flags is 4"):
        container.parse(with_checksum(data[:8] + b"\4" + data[9:]))


@STREAMS
def test_a_limit_of_gaussians(stream: StreamV3 | StreamV4) -> None:
    count = len(stream.gaussians())
    assert len(stream.gaussians(limits=Limits(max_gaussians=count))) == count
    for prefix in (1.0, 0.9):
        most = len(stream.gaussians(prefix)) - 1
        with pytest.raises(BitstreamError, match=rf"limit of {most} Gaussians$"):
            stream.gaussians(prefix, Limits(max_gaussians=most))


@STREAMS
def test_limits_of_parse(stream: StreamV3 | StreamV4) -> None:
    data, pixels = container.serialise(stream), stream.width * stream.height
    assert container.parse(data, Limits(max_pixels=pixels)).width == stream.width
    with pytest.raises(BitstreamError, match=f"limit of {pixels - 1}"):
        container.parse(data, Limits(max_pixels=pixels - 1))
    for length in range(HEADER_BYTES):
        with pytest.raises(BitstreamError):
            container.parse(with_checksum(data[:length]) if length > 8 else data[:length])
