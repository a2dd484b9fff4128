"""python -m service: serve, web, worker, alive or check."""

from __future__ import annotations

import sys


def main() -> int:
    """Run one command, and import only what it needs."""
    if sys.argv[1:] == ["alive"]:
        from service import alive

        return alive.main()
    from service import commands

    return commands.main()


if __name__ == "__main__":
    sys.exit(main())
