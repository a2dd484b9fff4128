"""python -m sgmethod: the command line."""

import sys

from sgmethod.cli import main

sys.exit(main())
