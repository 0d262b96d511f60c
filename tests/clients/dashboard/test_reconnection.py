"""The page's stream reconnects by itself, also over a slow network; in node."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import armrig.dashboard
import pytest

from tests.tools import needs

NODE = shutil.which("node")
pytestmark = needs("node")
PAGE = Path(armrig.dashboard.__file__).parent / "page"
SLOW_S = 0.5  # until a connection is answered: TLS on a phone at the edge of its network
_SCRIPT = """
globalThis.location = { hash: "#token=x" };
const real = fetch;
globalThis.fetch = (path, how) => real("%s/" + path, how);
const { Stream } = await import("%s");
new Stream({ hello: (n) => { console.log(n); if (n > 1) process.exit(); } }, () => {});
"""


class _Fading(BaseHTTPRequestHandler):
    """Counts its requests; after the first one it falls silent."""

    asked = 0
    ends = threading.Event()

    def do_GET(self) -> None:
        _Fading.asked += 1
        if _Fading.asked > 1:
            self.ends.wait(SLOW_S)
        with suppress(ConnectionError):  # the client has given up
            self.send_response(200)
            self.end_headers()
            self.wfile.write(f"event: hello\ndata: {json.dumps(_Fading.asked)}\n\n".encode())
            self.ends.wait()

    def log_message(self, *_: object) -> None:
        """Write nothing on the terminal."""


@pytest.fixture
def address() -> Iterator[str]:
    """Give where a server is that falls silent, and then is slow."""
    _Fading.asked = 0
    _Fading.ends.clear()
    with ThreadingHTTPServer(("127.0.0.1", 0), _Fading) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        _Fading.ends.set()
        server.shutdown()
        thread.join()


@pytest.mark.exhaustive
def test_a_slow_answer_is_waited_for(address: str, tmp_path: Path) -> None:
    (tmp_path / "package.json").write_text('{"type": "module"}')  # as a browser takes them
    for name in ("stream.js", "elements.js"):
        shutil.copy(PAGE / name, tmp_path)
    script = _SCRIPT % (address, (tmp_path / "stream.js").as_uri())
    command = [str(NODE), "--input-type=module", "-e", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)

    assert len(done.stdout.split()) == 2  # once before it fell silent, and once again
