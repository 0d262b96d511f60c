"""A program: use up one processor under the ordinary policy until the parent ends."""

from __future__ import annotations

from tests.benchmarks.host_timing.kernel import end_with_parent


def main() -> None:
    """Count for ever."""
    end_with_parent()
    while True:
        sum(range(10_000))


if __name__ == "__main__":
    main()
