"""The command `armrig`, and `python -m armrig`: Ctrl-C while it loads ends it in a line, too."""

from __future__ import annotations

import sys

from armrig_core.loading import end_at_ctrl_c


def main() -> int:
    """Load the command line, run it, and return the exit code."""
    has_loaded = end_at_ctrl_c("armrig")
    from armrig.cli import main as run

    has_loaded()
    try:
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
