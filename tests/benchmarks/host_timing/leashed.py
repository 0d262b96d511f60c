"""A program that becomes another program, which ends with this parent in any case.

Other projects' programs would outlive a benchmark that was killed.
"""

from __future__ import annotations

import os
import signal
import sys

from tests.benchmarks.host_timing.kernel import end_with_parent


def main() -> None:
    """Become the program in the arguments."""
    # The kernel's promise to send the signal outlives exec (prctl(2), PR_SET_PDEATHSIG).
    end_with_parent(signal.SIGTERM)
    os.execvp(sys.argv[1], sys.argv[1:])


if __name__ == "__main__":
    main()
