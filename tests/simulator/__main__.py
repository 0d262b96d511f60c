"""`python -m tests.simulator`: run schedules, or one again, and print the results."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from armrig_core.rig.firmware_image import IMAGES

from tests.simulator import campaign, story
from tests.simulator.options import Options, draw

_MOST_STORIES = 10
_STALLS = {"tolerated": True, "suffered": False}


def main() -> int:
    """Return 0 where every invariant held and that means something."""
    parser = argparse.ArgumentParser(prog="python -m tests.simulator", description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="how many schedules")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="run this one again, and write its story")
    parser.add_argument(
        *("--stalls",), choices=list(_STALLS), help="stall the emulator's process besides"
    )
    parser.add_argument("--core", action="store_true", help="the device's firmware is the C core")
    parser.add_argument(
        *("--uno",), choices=IMAGES, default="", help="the device is an Uno in simavr, this image"
    )
    parser.add_argument("--workers", type=int, help="processes; one for each core unless given")
    parser.add_argument("--stories", type=Path, default=Path("simulator-stories"))
    asked = parser.parse_args()
    if asked.uno and (asked.stalls or asked.core):
        parser.error("an Uno has its own firmware, and is not stalled")
    kind = {"stalls": _STALLS.get(asked.stalls), "c_core": asked.core, "uno": asked.uno}
    if asked.seed is not None:
        return _again(draw(asked.seed, **kind), asked.stories)
    seeds = range(asked.first, asked.first + asked.seeds)
    done = campaign.run(seeds, **kind, workers=asked.workers)
    print("\n".join(done.lines()))
    for seed, invariant, t_ns, text in done.violations[:_MOST_STORIES]:
        again = f"make simulate SEED={seed}" + (f" STALLS={asked.stalls}" if asked.stalls else "")
        again += " CORE=1" if asked.core else f" UNO={asked.uno}" if asked.uno else ""
        print(f"{invariant} at {t_ns / 1e6:.3f} ms: {text}\n  {again}")
        path = _path(seed, asked.stories)
        story.write(draw(seed, **kind), path)
        print(f"  its story: {path}")
    if len(done.violations) > _MOST_STORIES:
        print(f"and the seeds {', '.join(str(v[0]) for v in done.violations[_MOST_STORIES:])}")
    empty = done.emptiness()
    for line in empty:
        print(f"this campaign means nothing: {line}")
    late = done.lateness()
    for line in late:
        print(f"later than told: {line}")
    return 1 if done.violations or empty or late else 0


def _again(options: Options, folder: Path) -> int:
    print("\n".join(options.lines()))
    path = _path(options.seed, folder)
    outcome = story.write(options, path)
    print(f"bytes on the line: {outcome.digest}\nits story: {path}")
    if outcome.violation is None:
        print("no violation")
        return 0
    invariant, t_ns, text = outcome.violation
    print(f"{invariant} at {t_ns / 1e6:.3f} ms: {text}")
    return 1


def _path(seed: int, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{seed}.txt"


if __name__ == "__main__":
    sys.exit(main())
