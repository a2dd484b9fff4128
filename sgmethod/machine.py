"""The cores and the memory that this process may use: those of the machine, or what control groups leave of them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

UNLIMITED = 1 << 60  # version 1 of control groups writes no limit as a number near 2^63


def cores(root: Path = Path("/")) -> int:
    """Return the cores of the process's affinity mask, or the whole ones of its smallest quota; at least 1."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for folder in _groups(root, "cpu"):
        # Version 2: "250000 100000", or "max 100000" without a limit. Version 1: two files, with -1 for no limit.
        text = _text(folder / "cpu.max") or _text(folder / "cpu.cfs_quota_us") + _text(folder / "cpu.cfs_period_us")
        with suppress(ValueError, ZeroDivisionError):
            quota, period = map(int, text.split())
            found = min(found, max(quota // period, 1)) if quota > 0 else found
    return found


def memory(root: Path = Path("/")) -> int:
    """Return the bytes of memory of the machine, or of the smallest control group around this process."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for folder in _groups(root, "memory"):
        limits += _numbers(folder / "memory.max") + _numbers(folder / "memory.limit_in_bytes")
        limits += _numbers(folder / "memory.stat", "hierarchical_memory_limit ")  # also of groups that are not seen
    return min(limit for limit in limits if 0 < limit < UNLIMITED)


def _groups(root: Path, controller: str) -> Iterator[Path]:
    """Yield the folders of the process's groups and of those above them, up to the mount.

    A container may see only its own group, at the mount. Folders that do not exist limit nothing.
    """
    own = {"": "", controller: ""}  # the groups of version 2 and of version 1
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, _, controllers_and_group = line.partition(":")  # "number:controllers:/group"
        controllers, _, group = controllers_and_group.partition(":")
        own |= {name: group.strip("/") for name in controllers.split(",") if name in own and group.startswith("/")}
    # Usual mount points; "unified" is version 2 beside version 1.
    for name, mount in (("", "."), ("", "unified"), (controller, controller), (controller, "cpu,cpuacct")):
        top = root / "sys/fs/cgroup" / mount
        folder = top / own[name]
        yield from (one for one in (folder, *folder.parents) if one.is_relative_to(top))


def _numbers(file: Path, name: str = "") -> list[int]:
    """Return the number of a file, or of its line that begins with a name; nothing for "max" or a missing file."""
    words = [line.removeprefix(name) for line in _text(file).splitlines() if line.startswith(name)]
    return [int(word) for word in words if word.strip().isdigit()]


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
