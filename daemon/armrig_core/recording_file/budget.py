"""Limits on the cost of reading a file: a small file must not take hours or all memory."""

from __future__ import annotations

from armrig_core.errors import ArmrigError

MESSAGES_LIMIT, MESSAGES_PER_BYTE = 40 << 20, 16
"""Limit on the messages other than samples, in B.

For a file of n B, the limit is `MESSAGES_LIMIT` + n `MESSAGES_PER_BYTE`.
"""
UNPACKED_LIMIT, UNPACKED_PER_BYTE, UNPACKED_MORE = 64 << 20, 64, 4 << 30
"""Limit on the unpacked chunks, in B.

For a file of n B, the limit is `UNPACKED_LIMIT` + min(n `UNPACKED_PER_BYTE`, n + `UNPACKED_MORE`).
"""
WORK_LIMIT, BYTES_PER_WORK = 3_000_000, 64
"""Limit on the work with records; skipping one message costs one unit, about 1 µs.

For a file of n B the limit is `WORK_LIMIT` + n / `BYTES_PER_WORK` units. A recording of one hour at
1 kHz, 290 MB, needs 1 to 2 million units.
"""
SAMPLES_LIMIT = 1 << 24
"""Limit on the samples of a file, and on the rows of its time grid: 4.5 hours at 1 kHz."""

WORK, KEPT = "units of work with records", "B of messages other than samples"
UNPACKED = "B in its unpacked chunks"


class DamageError(ArmrigError):
    """The file is damaged, and reading cannot continue; the message gives the reason."""


class Budget:
    """Cost of reading a file up to now, and the limits of this cost."""

    def __init__(self, size: int) -> None:
        """Set the limits for a file of `size` B."""
        more = min(UNPACKED_PER_BYTE * size, size + UNPACKED_MORE)
        self.limits = {
            WORK: WORK_LIMIT + size // BYTES_PER_WORK,
            KEPT: MESSAGES_LIMIT + MESSAGES_PER_BYTE * size,
            UNPACKED: UNPACKED_LIMIT + more,
        }
        self.spent = dict.fromkeys(self.limits, 0)

    def spend(self, quantity: str, cost: int) -> None:
        """Add a cost; raise DamageError if it exceeds the limit."""
        self.spent[quantity] += cost
        if self.spent[quantity] > self.limits[quantity]:
            raise DamageError(f"more than {self.limits[quantity]} {quantity}")

    def regain(self, quantity: str) -> None:
        """Set a cost to 0, because the counted memory was released."""
        self.spent[quantity] = 0
