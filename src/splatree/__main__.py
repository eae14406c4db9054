"""``python -m splatree`` is the command ``splatree``."""

import sys

from splatree.cli.start import main

if __name__ == "__main__":
    sys.exit(main())
