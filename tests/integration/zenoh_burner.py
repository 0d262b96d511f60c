"""Another program that receives a flood, in place of the daemon.

`python zenoh_burner.py ENDPOINT CREDENTIAL`, until it is killed.
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

import zenoh
from armrig_core.credential import read_credential


def main(endpoint: str, credential: str) -> None:
    """Refuse all queries of the state, and drop messages of more than 8 MiB."""
    config = {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "link": {
                "tls": read_credential(Path(credential), "rig").tls("listen"),
                "rx": {"max_message_size": 8 << 20},
            }
        },
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        session.declare_queryable("rig/1/cmd/status/*", lambda query: query.reply_err(b"no"))
        print("there", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
