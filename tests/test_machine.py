"""The cores and the memory that a machine or container has, as the system tells it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from service.settings import IDLE_BYTES, Settings
from sgmethod import machine

CPUS, TOTAL = 64, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
MB = 1 << 20
GROUPS, MOUNT = "proc/self/cgroup", "sys/fs/cgroup"


def write(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


def v1(folder: str, quota: int) -> dict[str, str]:
    return {
        f"{MOUNT}/{folder}/cpu.cfs_quota_us": f"{quota}\n",
        f"{MOUNT}/{folder}/cpu.cfs_period_us": "100000\n",
    }


@pytest.mark.parametrize(
    ("quota", "expected"),
    [
        ("max 100000\n", CPUS),
        ("250000 100000\n", 2),
        ("50000 100000\n", 1),
        ("", CPUS),
        ("?", CPUS),
        ("300000", CPUS),
        ("300000 0", CPUS),
        ("99999999999999999999999 1", CPUS),
    ],
)
def test_cores_of_a_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quota: str, expected: int) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(CPUS)))
    write(tmp_path, {f"{MOUNT}/cpu.max": quota})
    assert machine.cores(tmp_path) == expected


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, CPUS),
        ({GROUPS: "0::/a/b\n", f"{MOUNT}/a/b/cpu.max": "300000 100000", f"{MOUNT}/a/cpu.max": "500000 100000"}, 3),
        ({GROUPS: "0::/a/b\n", f"{MOUNT}/a/b/cpu.max": "max 100000", f"{MOUNT}/a/cpu.max": "200000 100000"}, 2),
        ({GROUPS: "0::/a\n", f"{MOUNT}/a/b/cpu.max": "100000 100000", f"{MOUNT}/c/cpu.max": "100000 100000"}, CPUS),
        ({GROUPS: "0::/on/the/host\n", f"{MOUNT}/cpu.max": "400000 100000"}, 4),
        ({GROUPS: "nonsense\n::\n0::\n0::relative\n\n", f"{MOUNT}/cpu.max": "200000 100000"}, 2),
        (v1("cpu", -1), CPUS),
        (v1("cpu,cpuacct", 350_000), 3),
        ({GROUPS: "7:memory:/m\n4:cpu,cpuacct:/a/b\n"} | v1("cpu/a/b", -1) | v1("cpu/a", 200_000), 2),
        ({GROUPS: "4:cpuset:/a\n3:cpu:/b\n"} | v1("cpu/a", 100_000) | v1("cpu/b", 500_000), 5),
        (
            {GROUPS: "4:cpu:/a\n0::/b\n", f"{MOUNT}/unified/b/cpu.max": "500000 100000"} | v1("cpu/a", 600_000),
            5,
        ),
    ],
)
def test_cores_of_control_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, str], expected: int
) -> None:
    """Of the own group and of those above it, in version 2, in version 1, and in both beside each other."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(CPUS)))
    write(tmp_path, files)
    assert machine.cores(tmp_path) == expected


def test_cores_of_this_process() -> None:
    assert 1 <= machine.cores() <= len(os.sched_getaffinity(0))


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, TOTAL),
        ({GROUPS: "0::/\n", f"{MOUNT}/memory.max": "max\n"}, TOTAL),
        ({GROUPS: "0::/\n", f"{MOUNT}/memory.max": f"{900 * MB}\n"}, 900 * MB),
        (  # the smallest of those around it
            {
                GROUPS: "0::/a/b\n",
                f"{MOUNT}/a/b/memory.max": "max\n",
                f"{MOUNT}/a/memory.max": f"{700 * MB}\n",
            },
            700 * MB,
        ),
        (  # version 1, whose unlimited groups have a huge number
            {
                GROUPS: "5:cpu:/x\n4:memory:/x\n",
                f"{MOUNT}/memory/x/memory.limit_in_bytes": f"{2**63 - 4096}\n",
                f"{MOUNT}/memory/memory.limit_in_bytes": f"{800 * MB}\n",
            },
            800 * MB,
        ),
    ],
    ids=["none", "unlimited", "of a container", "of a group around it", "version 1"],
)
def test_memory_of_control_groups(tmp_path: Path, files: dict[str, str], expected: int) -> None:
    write(tmp_path, files)
    assert machine.memory(tmp_path) == expected


def test_limits_follow_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """8 GiB were allowed in a container of 1 GB: the system killed encodes, and clients were blamed."""
    for memory, encode, decode in (
        (1 << 40, 8 << 30, 2 << 30),
        (900 * MB, 900 * MB - IDLE_BYTES, 512 * MB),
        (512 * MB, 512 * MB - IDLE_BYTES, 512 * MB - IDLE_BYTES),
        (64 * MB, 2**28, 2**28),
    ):
        monkeypatch.setattr(machine, "memory", lambda memory=memory: memory)
        settings = Settings()
        assert (settings.job_memory_bytes, settings.decode_memory_bytes) == (encode, decode)
    assert Settings(job_memory_bytes=16 << 30).decode_memory_bytes == 4 << 30
