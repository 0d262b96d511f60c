"""`python -m armrig` is the command `armrig`."""

from __future__ import annotations

import sys

from armrig.cli import main

if __name__ == "__main__":
    sys.exit(main())
