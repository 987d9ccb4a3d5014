"""`python -m gmdx` is the command `gmdx`."""

import sys

from gmdx.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
