"""The command `armrigd`, also `python -m armrig_daemon`; Ctrl-C also ends its imports."""

from __future__ import annotations

import sys

from armrig_core.process.loading import end_at_ctrl_c, is_interrupt, use_one_thread


def main() -> None:
    """Import the command line and run it."""
    has_loaded = end_at_ctrl_c("armrigd")
    use_one_thread()
    from armrig_daemon.command_line import app

    has_loaded()
    try:
        app()
    except (KeyboardInterrupt, RuntimeError) as err:
        if not is_interrupt(err):
            raise
        print("armrigd: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        exec("")  # as in armrig/__main__.py: otherwise Python may end by SIGINT


if __name__ == "__main__":
    main()
