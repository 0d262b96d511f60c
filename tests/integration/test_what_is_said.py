"""Messages about a served rig."""

from __future__ import annotations

from tests.integration.processes import Bench, wait_for


def test_the_daemon_and_the_emulator_print_what_they_serve(bench: Bench) -> None:
    bench.configure(more="[limits]\nu_max_v = 4.5")
    emulator = bench.emulate()
    daemon = bench.serve()

    wait_for(lambda: emulator.said and "armrig status" in daemon.said)
    served, emulated = (
        [line for line in program.said.splitlines() if "not granted" not in line]
        for program in (daemon, emulator)
    )
    assert emulated == [
        f"armrigd: an emulated rig is at {bench.port}, 1000000 baud, 0 to 5 V; drive it with "
        f"`ARMRIG_DEVICE_BAUD=1000000 armrigd run --port {bench.port}`, end it with Ctrl-C"
    ]
    assert served == [
        f"armrigd: info: rig 1 at {bench.endpoint}",
        f"armrigd: info: port {bench.port} at 1000000 baud, 0 to 4.5 V; ask it with "
        "`armrig status`, end it with Ctrl-C",
    ]
