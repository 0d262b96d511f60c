"""Input signals for the rig, in volts and inside its 0 to 5 V, a family a module.

All are float64 (N,), the same for the same seed, and none leaves the interval asked for.
"""

from armrig.excitation.binary import prbs, telegraph, white_noise
from armrig.excitation.from_file import from_csv
from armrig.excitation.levels import HIGHEST_V, LOWEST_V, staircase, step, within
from armrig.excitation.sines import chirp, multisine

__all__ = [
    "HIGHEST_V",
    "LOWEST_V",
    "chirp",
    "from_csv",
    "multisine",
    "prbs",
    "staircase",
    "step",
    "telegraph",
    "white_noise",
    "within",
]
