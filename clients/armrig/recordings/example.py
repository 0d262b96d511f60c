"""The example recording: data for trying armrig without a rig."""

from __future__ import annotations

from pathlib import Path

from armrig.recordings.loading import load
from armrig.recordings.recording import Recording

_FILE = Path(__file__).with_name("example.mcap")
"""Recording of a telegraph signal, made by `armrig demo --virtual` of armrig 0.1.0."""


def example_recording() -> Recording:
    """Return a recording of the emulated rig, for trying armrig without a rig.

    The recording contains 3000 samples, one every 10 ms. The motor voltage is a telegraph signal
    of 0.5 V and 4.5 V. `armrig demo --virtual` records the same experiment.

    Returns
    -------
    Recording
        30 s of `u` in V, `theta_1` and `alpha` in rad.

    Examples
    --------
    >>> import armrig
    >>> recording = armrig.example_recording()
    >>> recording.N, recording.Ts
    (3000, 0.01)
    >>> armrig.oe(recording.dataset(), nb=4, nf=4, integrator=True).label
    'OE[4 4 1]'
    """
    return load(_FILE)
