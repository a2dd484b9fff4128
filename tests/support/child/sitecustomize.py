"""What a service of a test does differently, which Python loads at its start where PYTHONPATH names this folder.

Constants of the settings have the values of TEST_CONSTANTS, as JSON.

With PYTHON_FAKE_CODEC (whose name the sandbox may see), `sgmethod.codec` is a fake, and the sandbox the real one up to
there. The codec takes torch, and 2.5 s of a core. The fake takes the time limit to the letter unless a test's signal
ends it, no core, and makes a file of one Gaussian.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType, SimpleNamespace
from typing import Any

NAME = "sgmethod.codec"
STEPS = 4
POLL_S = 0.05  # how soon it ends after the signal
END = signal.SIGUSR1  # which tests.support.processes.end_early() sends


def encode(
    image: Any,
    _budget: Any = None,
    profile: str = "rd",
    *,
    time_limit_s: float | None = None,
    on_progress: Callable[[Any], None] = lambda _: None,
    **_more: Any,
) -> Any:
    """As sgmethod.codec.encode has it."""
    import numpy as np

    from sgmethod.bitstream import container
    from sgmethod.bitstream.v2 import StreamV2
    from sgmethod.io.image import read_input
    from sgmethod.scene import Gaussians
    from sgmethod.trace import TracePoint

    limit_s, asked = time_limit_s or 0.0, list[int]()
    before = signal.signal(END, lambda number, _frame: asked.append(number))
    pixels = read_input(image, keep_alpha=True)
    for step in range(STEPS + 1):
        seconds = limit_s * step / STEPS
        on_progress(TracePoint(seconds, step, STEPS, 20.0 + step, 0, 1, "joint", step / STEPS))
        if step < STEPS:
            _sleep(limit_s / STEPS, asked)
        if asked:
            break
    signal.signal(END, before)  # forks of a sandbox that has warmed up do not listen before they encode
    height, width = pixels.shape[:2]
    middle, shape = (width / 2, height / 2), (width / 4, 0, height / 4)
    one = Gaussians(*(np.array([values], np.float32) for values in (middle, shape, (0.5, 0.5, 0.5))))
    data = container.serialise(StreamV2.from_gaussians(one, (width, height), 0.5, (0, 0, 0), False))
    bpp = 8 * len(data) / (width * height)
    figures = {"bytes": len(data), "bpp": bpp, "psnr": 24.0, "gaussians": 1, "steps": STEPS, "seconds": limit_s}
    figures |= {"width": width, "height": height, "profile": profile, "tune": "psnr", "effort": 5, "warnings": []}
    figures |= dict.fromkeys(("ssimulacra2", "psnr_missed_db", "quality_missed"))
    return SimpleNamespace(data=data, stats=SimpleNamespace(psnr=24.0, warnings=[], to_dict=lambda: figures))


def encode_as(_asked: Any, image: Any, limit_s: float | None = None) -> Any:
    """As sgmethod.codec.encode_as has it, for a preview."""
    return encode(image, time_limit_s=limit_s)


def _sleep(seconds: float, asked: Sequence[int]) -> None:
    until = time.monotonic() + seconds
    while not asked and (left := until - time.monotonic()) > 0:
        time.sleep(min(left, POLL_S))


class _StandIn(MetaPathFinder, Loader):
    def find_spec(
        self, name: str, _path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return spec_from_loader(name, self) if name == NAME else None

    def exec_module(self, module: ModuleType) -> None:
        module.encode, module.encode_as = encode, encode_as  # type: ignore[attr-defined]


if os.environ.get("PYTHON_FAKE_CODEC"):
    sys.meta_path.insert(0, _StandIn())
if constants := os.environ.get("TEST_CONSTANTS"):
    from service.settings import Settings

    for name, value in json.loads(constants).items():
        setattr(Settings, name, value)
