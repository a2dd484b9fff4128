"""python -m sgmethod: the command line."""

import sys

from sgmethod.cli.main import main

sys.exit(main())
