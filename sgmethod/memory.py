"""The memory that this process may use, from which some defaults follow."""

from __future__ import annotations

import os
from pathlib import Path

UNLIMITED = 1 << 60  # version 1 of control groups writes no limit as a number near 2^63


def available(root: Path = Path("/")) -> int:
    """Return the bytes of memory that this process may use: of the machine, or of the smallest control group around it.

    A container may see only its own group, and not the limits of those around it, except in version 1.
    """
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    mount = root / "sys/fs/cgroup"
    limits = [total]
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, group = line.split(":", 2)
        if not controllers:
            limits += [limit for folder in _upwards(mount, group) for limit in _numbers(folder / "memory.max")]
        elif "memory" in controllers.split(","):
            for folder in _upwards(mount / "memory", group):
                limits += _numbers(folder / "memory.limit_in_bytes")
                limits += _numbers(folder / "memory.stat", "hierarchical_memory_limit ")
    return min(limit for limit in limits if 0 < limit < UNLIMITED)


def _upwards(mount: Path, group: str) -> list[Path]:
    """Return the folders from a group up to the mount. Those that a container does not see do not exist."""
    folder = mount / group.strip("/")
    return [folder, *(parent for parent in folder.parents if parent.is_relative_to(mount))]


def _numbers(file: Path, name: str = "") -> list[int]:
    """Return the number of a file, or of its line that begins with a name; nothing for "max" or a missing file."""
    words = [line.removeprefix(name) for line in _text(file).splitlines() if line.startswith(name)]
    return [int(word) for word in words if word.strip().isdigit()]


def _text(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:
        return ""
