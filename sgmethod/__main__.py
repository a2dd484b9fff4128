"""python -m sgmethod: the command line."""

import sys

from sgmethod.cli.main import main

if __name__ == "__main__":  # encodes in processes of their own import it under another name
    sys.exit(main())
