"""Fails one allocation of the kernels after the other, and sees that the process goes on with right results.

A program of its own, run with shims/allocations.c preloaded: python -m tests.native.failing workers|kernels
An action ends with its right result or with MemoryError, and the next one is right. Prints how many of each there were,
a line for each action.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterable
from functools import cache
from itertools import count

import numpy as np

from sgmethod import Budget, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.io.image import read_image_8_bit
from sgmethod.native import native
from sgmethod.scene import Gaussians
from tests.native.harness.golden import GOLDEN, is_golden
from tests.rd.short import short
from tests.support.data import EXAMPLES, PHOTOGRAPHS
from tests.support.profiles import encode_with

WIDTH, HEIGHT = 200, 150
Action = Callable[[], bytes]


def scattered(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, factors and colours of Gaussians all over a picture."""
    rng = np.random.default_rng(0)
    means = rng.uniform(0, 1, (n, 2)) * (WIDTH, HEIGHT)
    factors = np.exp(rng.uniform(-1, 3, (n, 3)))
    return means.astype(np.float32), factors.astype(np.float32), rng.normal(0, 0.3, (n, 3)).astype(np.float32)


def joined(*arrays: np.ndarray) -> bytes:
    return b"".join(array.tobytes() for array in arrays)


def decodes(name: str) -> Action:
    def action() -> bytes:
        pixels = decode(GOLDEN[name])
        assert is_golden(name, pixels), f"{name} decodes to other pixels"
        return pixels.tobytes()

    return action


@cache
def large_file() -> bytes:
    """With Gaussians enough for tasks that take memory, on several levels."""
    stream = StreamV2.from_gaussians(Gaussians(*scattered(5000)), (WIDTH, HEIGHT), 0.05, (9, 9, 9), False)
    return container.serialise(stream)


def decode_large() -> bytes:
    return decode(large_file()).tobytes()


def gradients() -> bytes:
    means, factors, colors = scattered(2000)
    target = np.full((3, HEIGHT, WIDTH), 0.5, np.float32)
    raster = native.Rasterization(means, factors, WIDTH, HEIGHT, native.CUTOFF_V2, pyramid=True)
    first = [np.empty_like(array) for array in (means, factors, colors)]
    second = [np.empty_like(array) for array in (means, factors, colors)]
    raster.backward(colors, target, *first)
    raster.squared_error(colors, (target * native.TARGET_WHITE).astype(np.int16), *second)
    raster.gram(colors, gram := np.empty_like(colors))
    loss = native.ReconstructionLoss(target, 0.5)
    loss(target, grad := np.empty_like(target))
    return joined(*first, *second, grad, gram)


def refine() -> bytes:
    parameters = native.RdParameters(WIDTH, HEIGHT, 0.1)
    target = np.full((3, HEIGHT, WIDTH), native.TARGET_WHITE // 2, np.int16)
    return native.rd_refine(parameters, *scattered(20), target, 0.01, 1, 60.0, 100)


def encode() -> bytes:
    crop = np.ascontiguousarray(read_image_8_bit((PHOTOGRAPHS / "kodim23-crop.png").read_bytes())[24:56, 40:80])
    return encode_with(short(40), crop, Budget("bytes", 300)).data


SCENARIOS: dict[str, Action] = {
    **{f"decode-{name}": decodes(name) for name in EXAMPLES},
    "decode-large": decode_large,
    "gradients": gradients,
    "refine": refine,
    "encode": encode,
}


def numbers(scenario: str, whose: str) -> Iterable[int]:
    """Which allocations fail: each in turn; of the thousands of an encode, the first and then fewer and fewer.

    Which thread takes which task differs from call to call, and so does the number of allocations of the workers.
    """
    if whose == "workers":
        return range(1, 41)
    return count(1) if scenario != "encode" else (*range(1, 5), *(round(5 * 1.9**k) for k in range(30)))


def survive(shim: ctypes.CDLL, scenario: str, whose: str) -> tuple[int, int]:
    """How many actions ended with MemoryError, and how many with the right result."""
    action = SCENARIOS[scenario]
    expected = action()
    errors = right = 0
    for number in numbers(scenario, whose):
        native.set_thread_count(2 + number % 2)  # so that starting the threads is part of it
        shim.fail_allocation(number, whose == "workers")
        try:
            result = action()
        except MemoryError:
            result = b""
            errors += 1
        finally:
            counted = shim.fail_no_more()
        assert result in (b"", expected), f"{scenario}: a wrong result when allocation {number} fails"
        right += result == expected
        for name in EXAMPLES:
            assert is_golden(name, decode(GOLDEN[name])), (
                f"{scenario}: {name} is wrong after allocation {number} failed"
            )
        assert action() == expected, f"{scenario}: a wrong result after allocation {number} failed"
        if counted < number and whose == "kernels":
            break
    return errors, right


def main() -> None:
    (whose,) = sys.argv[1:]
    shim = ctypes.CDLL(None)
    shim.fail_allocation.argtypes = [ctypes.c_long, ctypes.c_int]
    shim.fail_no_more.restype = ctypes.c_long
    for scenario in SCENARIOS:
        if scenario != "encode" or whose == "kernels":  # torch has threads of its own, and fails in its own ways
            print(scenario, *survive(shim, scenario, whose))


if __name__ == "__main__":
    main()
