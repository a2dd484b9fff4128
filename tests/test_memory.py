"""The memory that a machine or container has, as the system tells it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from service.settings import IDLE_BYTES, Settings
from sgmethod.memory import available

TOTAL = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
MB = 1 << 20


def write(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, TOTAL),
        ({"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/memory.max": "max\n"}, TOTAL),
        ({"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/memory.max": f"{900 * MB}\n"}, 900 * MB),
        (  # the smallest of those around it
            {
                "proc/self/cgroup": "0::/a/b\n",
                "sys/fs/cgroup/a/b/memory.max": "max\n",
                "sys/fs/cgroup/a/memory.max": f"{700 * MB}\n",
            },
            700 * MB,
        ),
        (  # version 1, whose unlimited groups have a huge number
            {
                "proc/self/cgroup": "5:cpu:/x\n4:memory:/x\n",
                "sys/fs/cgroup/memory/x/memory.limit_in_bytes": f"{2**63 - 4096}\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": f"{800 * MB}\n",
            },
            800 * MB,
        ),
    ],
    ids=["none", "unlimited", "of a container", "of a group around it", "version 1"],
)
def test_memory_of_control_groups(tmp_path: Path, files: dict[str, str], expected: int) -> None:
    write(tmp_path, files)
    assert available(tmp_path) == expected


def test_limits_follow_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """8 GiB were allowed in a container of 1 GB: the system killed encodes, and clients were blamed."""
    for memory, encode, decode in (
        (1 << 40, 8 << 30, 2 << 30),
        (900 * MB, 900 * MB - IDLE_BYTES, 512 * MB),
        (512 * MB, 512 * MB - IDLE_BYTES, 512 * MB - IDLE_BYTES),
        (64 * MB, 2**28, 2**28),
    ):
        monkeypatch.setattr("service.settings.available", lambda memory=memory: memory)
        settings = Settings()
        assert (settings.job_memory_bytes, settings.decode_memory_bytes) == (encode, decode)
    assert Settings(job_memory_bytes=16 << 30).decode_memory_bytes == 4 << 30
