"""The command `armrig`, and `python -m armrig`: Ctrl-C while it loads ends it in a line, too."""

from __future__ import annotations

import sys


def main() -> int:
    """Load the command line, run it, and return the exit code."""
    try:
        from armrig.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("armrig: interrupted", file=sys.stderr)
        return 130
    finally:
        # Python ends itself by SIGINT, whatever the exit code, after a KeyboardInterrupt in a text
        # that is executed, as that of a dataclass. The next such text has it forget that.
        exec("")


if __name__ == "__main__":
    sys.exit(main())
