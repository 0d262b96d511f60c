"""A client of rig 1 that connects again and again; each error is a line on standard error.

`python connected_client.py run|subscriber|status|page|recorder`

A line on standard output is a sign that it is connected.
"""

from __future__ import annotations

import json
import sys
import time
import urllib.request
from collections.abc import Callable

from armrig.cli import main
from armrig.dashboard.serving import Settings, dashboard
from armrig.rig.client import Rig
from armrig.rig.session import RigError


def _run() -> None:
    main(["reset"])  # out of the ESTOP after a kill
    main(["collect", "step", "--seconds", "120", "--at", "0.5", "--name", "restarted"])


def _subscriber() -> None:
    with Rig() as rig:
        for n, _ in enumerate(rig.stream("sample")):
            if n % 20 == 0:
                print(n, flush=True)


def _status() -> None:
    with Rig() as rig:
        while True:
            print(rig.status().phase, flush=True)
            time.sleep(0.1)


def _page() -> None:
    """Read the stream of the page as a browser does; show its trouble when that changes."""
    shown = ""
    with dashboard(Settings(rig="1", connect=None, port=None, share=None)) as served:
        address, _, token = served.url.partition("#token=")
        asked = urllib.request.Request(
            f"{address.rstrip('/')}/api/stream", headers={"Authorization": f"Bearer {token}"}
        )
        with urllib.request.urlopen(asked) as events:
            for line in events:
                if not line.startswith(b"data: {"):
                    continue
                trouble = json.loads(line[6:]).get("trouble")
                if trouble and trouble != shown:
                    print(trouble, file=sys.stderr, flush=True)
                if trouble == "":
                    print("connected", flush=True)
                shown = shown if trouble is None else trouble


def _recorder() -> None:
    main(["record", "-o", "afar.mcap"])


CLIENTS: dict[str, Callable[[], None]] = {
    "run": _run,
    "subscriber": _subscriber,
    "status": _status,
    "page": _page,
    "recorder": _recorder,
}

if __name__ == "__main__":
    while True:
        try:
            CLIENTS[sys.argv[1]]()
        except RigError as err:
            print(err, file=sys.stderr, flush=True)
        time.sleep(0.1)
