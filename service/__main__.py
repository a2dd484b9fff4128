"""python -m service: serve, web, worker or check."""

from __future__ import annotations

import sys

from service.commands import main

if __name__ == "__main__":
    sys.exit(main())
