"""Input signals for the rig, in volts, with one module for each family of signals.

Each signal is an array float64 (N,) with values inside the requested interval, which must be inside
0 to 5 V. The same seed leads to the same signal.
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
