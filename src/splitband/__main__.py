"""`python -m splitband` is the command line."""

import sys

from splitband.cli import main

if __name__ == "__main__":
    sys.exit(main())
