"""Entry point of `python -m rce.cli`."""

import sys

from rce.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
