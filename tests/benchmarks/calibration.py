"""Calibrations of rigs that nobody has seen, against what they are: how often within 3 sigma.

`python -m tests.benchmarks.calibration [seeds]`: one line a quantity. A seed counts where all of
its quantities, and both directions, are found.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from tests.clients.calibration_rig import calibrated, truth, unknown_rig


def main(seeds: int) -> None:
    """Calibrate one rig per seed and print the results."""
    began = time.perf_counter()
    z: dict[str, list[float]] = {}
    std: dict[str, list[float]] = {}
    directions = alone = 0
    for seed in range(seeds):
        settings = unknown_rig(seed)
        estimate = calibrated(settings)
        found, true = estimate.figures(), truth(settings)
        signs = estimate.alpha_sign == (-1 if settings.alpha_reversed else 1)
        signs &= (found["theta_1_rad_per_count"].value < 0) == settings.theta_1_reversed
        directions += signs
        worst = 0.0
        for name, value in true.items():
            figure = found[name]
            off = figure.value - value
            of = off / figure.std if figure.std else (0.0 if off == 0 else np.inf)
            z.setdefault(name, []).append(of)
            std.setdefault(name, []).append(figure.std)
            worst = max(worst, abs(of))
        good = worst <= 3 and signs
        alone += good
        if not good:
            print(f"seed {seed}: {max(z, key=lambda n: abs(z[n][-1]))} {worst:.2f} sigma off")
    print(f"{'quantity':24} {'within 3 sigma':>14} {'mean z':>8} {'rms z':>7} {'median sigma':>13}")
    for name, values in z.items():
        at = np.array(values)
        print(
            f"{name:24} {np.count_nonzero(np.abs(at) <= 3):>10}/{seeds} {at.mean():>8.2f} "
            f"{np.sqrt(np.mean(at**2)):>7.2f} {np.median(std[name]):>13.3g}"
        )
    print(f"both directions: {directions}/{seeds}; everything at once: {alone}/{seeds} seeds")
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
