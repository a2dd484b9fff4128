"""The command line, as python -m sgmethod."""

import sys

from sgmethod.cli.main import main

if __name__ == "__main__":  # spawned worker processes import this module under another name
    sys.exit(main())
