"""Input signals for the rig, in volts, with one module for each family of signals.

The signals have these parameters in common:

- `N`: number of samples, an integer >= 1.
- `low`, `high`: interval or levels in V, 0 <= low < high <= 5.
- `seed`: integer >= 0 or numpy.random.Generator, 1 by default. The same seed gives the same signal.

Each signal is an array float64 (N,), the voltage in V at each sample, with values inside the
interval. A function raises a ValueError if a level is outside 0 to 5 V or another value is not
allowed.
"""

from armrig.excitation.binary import prbs, telegraph, white_noise
from armrig.excitation.from_file import input_from_file
from armrig.excitation.levels import HIGHEST_V, LOWEST_V, staircase, step, within
from armrig.excitation.sines import chirp, multisine

__all__ = [
    "HIGHEST_V",
    "LOWEST_V",
    "chirp",
    "input_from_file",
    "multisine",
    "prbs",
    "staircase",
    "step",
    "telegraph",
    "white_noise",
    "within",
]
