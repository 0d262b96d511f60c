"""What reading a file may cost: a small file must not cost hours, or all memory."""

from __future__ import annotations

from armrig_core.errors import ArmrigError

MESSAGES_LIMIT, MESSAGES_PER_BYTE = 40 << 20, 16
"""Of messages other than samples a file of n B may cost the first plus the second times n, in B."""
UNPACKED_LIMIT, UNPACKED_PER_BYTE, UNPACKED_MORE = 64 << 20, 64, 4 << 30
"""A file of n B may unpack to the first plus 64 n, but no more than n and the third, in B."""
WORK_LIMIT, BYTES_PER_WORK = 3_000_000, 64
"""Most work with records, in messages passed over, which take about 1 µs each.

One more for so many bytes of the file: an hour at 1 kHz, 290 MB, takes 1 to 2 million.
"""
SAMPLES_LIMIT = 1 << 24
"""Most samples of a file, and rows of a grid: four and a half hours at 1 kHz."""

WORK, KEPT = "units of work with records", "B of messages other than samples"
UNPACKED = "B in its chunks, unpacked"


class DamageError(ArmrigError):
    """Reading cannot go on from here; says why."""


class Budget:
    """What has been spent on a file, and how much there is."""

    def __init__(self, size: int, messages: int = 0) -> None:
        """Take the file's size, and what messages may cost, both in B; 0 for `MESSAGES_LIMIT`."""
        more = min(UNPACKED_PER_BYTE * size, size + UNPACKED_MORE)
        self.limits = {
            WORK: WORK_LIMIT + size // BYTES_PER_WORK,
            KEPT: messages or MESSAGES_LIMIT + MESSAGES_PER_BYTE * size,
            UNPACKED: UNPACKED_LIMIT + more,
        }
        self.spent = dict.fromkeys(self.limits, 0)

    def spend(self, what: str, cost: int) -> None:
        """Count a cost; raise DamageError where there is no more left for it."""
        self.spent[what] += cost
        if self.spent[what] > self.limits[what]:
            raise DamageError(f"more than {self.limits[what]} {what}")

    def regain(self, what: str) -> None:
        """Forget what was spent: it has been given back."""
        self.spent[what] = 0
