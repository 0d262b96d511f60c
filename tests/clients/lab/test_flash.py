"""`armrig flash`: the real avrdude writes into a boot loader's pages, and the board is asked after.

The program that was written then runs in simavr, from the bytes that the board holds.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.cli import administration as command
from armrig.cli import main
from armrig.lab import avrdude
from armrig.lab.avrdude import SerialBoard, choose_board
from armrig_core.errors import OperationError
from armrig_core.rig.firmware_image import image_path, read_image
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import Uno as SimulatedUno

from tests.clients import uno_with_optiboot
from tests.clients.uno_with_optiboot import Uno
from tests.sampling import sampled
from tests.tools import needs

pytestmark = needs("avrdude")
R3 = SerialBoard(port="/dev/ttyACM0", name="Arduino Uno R3 (2341:0043)", is_uno=True)
LEONARDO = SerialBoard(
    port="/dev/null", name="Arduino Leonardo (2341:8036)", is_uno=False, is_leonardo=True
)
CH340 = SerialBoard(port="/dev/ttyUSB0", name="Uno with a CH340 (1A86:7523)", is_uno=True)
PICO = SerialBoard(port="/dev/ttyACM1", name="unknown board: Pico (2E8A:000A)", is_uno=False)
Said = pytest.CaptureFixture[str]


class _EmulatedDevice(Device):
    """Another firmware than that which was written."""

    def close(self) -> None:
        """Nothing is held."""


def _another_firmware(flash: bytes, now_ns: int) -> _EmulatedDevice:
    return _EmulatedDevice(EmulatorSettings(), now_ns)


def _what_was_written(folder: Path, flash: bytes, now_ns: int) -> SimulatedUno:
    """Return a simulated Uno that runs the bytes of its flash."""
    image = folder / "flash.hex"
    image.write_text("".join(_records(flash)) + ":00000001FF\n", encoding="ascii")
    return SimulatedUno(uno_with_optiboot.FIL / "fil", image, EmulatorSettings(), now_ns)


def _records(data: bytes) -> Iterator[str]:
    for at in range(0, len(data), 16):
        record = bytes((len(data[at : at + 16]), at >> 8, at & 0xFF, 0)) + data[at : at + 16]
        yield f":{record.hex()}{-sum(record) & 0xFF:02x}\n"


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait longer for the program's answer: a simulated board may be slower than a real one."""
    monkeypatch.setattr(avrdude, "greeting", partial(avrdude.greeting, within_s=60.0))


@needs("simavr")
def test_the_firmware_is_written_verified_and_answers(
    tmp_path: Path, capsys: Said, patient: None
) -> None:
    image = read_image(image_path())
    uno_with_optiboot.harness()
    with Uno(partial(_what_was_written, tmp_path)) as uno:
        assert main(["flash", "--port", uno.port, "--yes", "--json"]) == 0

    told = json.loads(capsys.readouterr().out)
    assert bytes(uno.flash[: len(image.data)]) == image.data
    assert set(uno.flash[len(image.data) :]) == {0xFF}
    assert told["port"] == uno.port
    assert told["firmware"]["crc"] == told["device"]["firmware"] == f"{image.crc:08x}"
    assert (told["device"]["version"], told["device"]["state"]) == (2, "IDLE")


@pytest.mark.exhaustive
def test_a_board_that_runs_another_firmware_afterwards_is_reported(
    capsys: Said, patient: None
) -> None:
    with Uno(_another_firmware) as uno:
        assert main(["flash", "--port", uno.port, "--yes"]) == 1

    said = capsys.readouterr()
    assert "written; the board returned the same bytes" in said.out
    assert "reports the firmware 00000000, but" in said.err
    assert uno.left


@pytest.mark.exhaustive
def test_a_program_that_does_not_answer_is_reported(capsys: Said) -> None:
    deaf: Any = SimpleNamespace(receive=lambda *_: None, advance=lambda _: [], close=lambda: None)
    with Uno(lambda *_: deaf) as uno:
        assert main(["flash", "--port", uno.port, "--yes", "--baud", "1000000"]) == 1

    assert "does not answer at 1000000 baud" in capsys.readouterr().err


OLD = "the boot loader is ATmegaBOOT or similar, not Optiboot"
ANOTHER_CHIP = {"signature": bytes((0x1E, 0x95, 0x14))}


@pytest.mark.parametrize(
    ("fault", "words", "says", "is_written"),
    [
        (ANOTHER_CHIP, ["--yes"], "the chip on the board is not an ATmega328P", False),
        ({"stuck_bit": True}, ["--yes"], "the board's memory differs from the written", True),
        ({"version": (1, 16)}, ["--yes"], OLD, False),
        ({}, [], "--yes agrees", False),
        *sampled([({"version": (1, 16), "speed": termios.B57600}, ["--yes"], OLD, False)], 0),
    ],
)
def test_a_board_that_is_refused_is_reported_in_one_line(
    fault: dict[str, object], words: list[str], says: str, is_written: bool, capsys: Said
) -> None:
    with Uno(_another_firmware) as uno:
        for name, value in fault.items():
            setattr(uno, name, value)
        assert main(["flash", "--port", uno.port, *words]) == 1

    said = capsys.readouterr()
    assert says in " ".join(said.err.split())
    assert "read back" not in said.out
    assert (set(uno.flash) != {0xFF}) == is_written


def test_a_dry_run_prints_all_steps_and_sends_no_byte(capsys: Said) -> None:
    image = read_image(image_path())
    with Uno(_another_firmware) as uno:
        assert main(["flash", "--port", uno.port, "--dry-run"]) == 0
        assert main(["flash", "--port", uno.port, "--dry-run", "--json"]) == 0

    out, _, told = capsys.readouterr().out.rstrip().rpartition("\n")
    assert set(uno.flash) == {0xFF}
    for text in (uno.port, str(image.path), f"{len(image.data)} B", f"CRC-32 {image.crc:08x}"):
        assert text in out
    assert (
        json.loads(told)["command"][1:] == avrdude.command("", port=uno.port, image=image.path)[1:]
    )
    assert " ".join(json.loads(told)["command"]) in out


def test_a_port_held_by_a_daemon_is_refused(capsys: Said) -> None:
    """The daemon's opening of the port locks it."""
    with Uno(_another_firmware) as uno:
        daemon = os.open(uno.port, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(daemon, fcntl.LOCK_EX)
        assert main(["flash", "--port", uno.port, "--yes"]) == 1
        os.close(daemon)

    assert "is held by another program" in (said := capsys.readouterr().err)
    assert "systemctl stop armrigd@ID" in said
    assert set(uno.flash) == {0xFF}


def test_a_daemon_cannot_open_the_port_during_the_writing() -> None:
    """A daemon that systemd starts meanwhile finds the port taken."""
    from armrig_daemon.loop.link import Link, TakenPortError

    with Uno(_another_firmware) as uno:
        board = SerialBoard(port=uno.port, name="", is_uno=True)
        with avrdude.lock_port(board), pytest.raises(TakenPortError):
            Link(uno.port, 500_000)
        Link(uno.port, 500_000).close()


def test_a_confirmation_for_the_motor_is_required_before_the_first_byte(
    typed: Callable[[str], None], capsys: Said
) -> None:
    typed("n\n")
    with Uno(_another_firmware) as uno:
        assert main(["flash", "--port", uno.port]) == 1

    said = capsys.readouterr()
    assert command.MOTOR in said.out
    assert "Write the board? [y/N]:armrig: nothing was done" in said.err
    assert set(uno.flash) == {0xFF}


def test_a_missing_avrdude_is_reported_with_its_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))

    assert main(["flash", "--dry-run"]) == 1
    assert "apt install avrdude" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("port", "there", "found"),
    [
        (None, [CH340, PICO, R3], f"2 boards: {CH340}, {R3}; choose one by --port"),
        (None, [PICO, R3], R3),
        (None, [CH340], CH340),
        (None, [], "no board is plugged in by USB"),
        (None, [PICO], "no Uno is plugged in, but unknown board: Pico (2E8A:000A) at /dev/ttyACM1"),
        (None, [R3, CH340], "2 boards: Arduino Uno R3 (2341:0043) at /dev/ttyACM0, Uno with"),
        (None, [LEONARDO], "no Uno is plugged in, but Arduino Leonardo (2341:8036) at /dev/null"),
        ("/dev/null", [LEONARDO], "/dev/null: armrig's firmware runs on an Uno (ATmega328P) only"),
        ("/dev/no-such-port", [R3], "/dev/no-such-port does not exist; there is Arduino Uno R3"),
    ],
)
def test_the_board_is_chosen_by_port_or_by_name(
    port: str | None, there: list[SerialBoard], found: SerialBoard | str
) -> None:
    if isinstance(found, SerialBoard):
        assert choose_board(port, there) == found
        return
    with pytest.raises(OperationError) as refused:
        choose_board(port, there)
    assert found in str(refused.value)
    assert ("--port" in str(refused.value)) == (port is None)


def test_a_lab_refuses_a_leonardo(capsys: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(avrdude, "usb_boards", lambda: [LEONARDO])

    assert main(["lab", "--port", "/dev/null"]) == 1
    assert "runs on an Uno (ATmega328P) only; put the shield on an Uno" in capsys.readouterr().err


def test_a_board_selected_by_its_persistent_name_keeps_it(tmp_path: Path) -> None:
    port = tmp_path / "ttyACM0"
    port.touch()
    link = tmp_path / "armrig-5563"
    link.symlink_to(port)

    board = choose_board(str(link), [SerialBoard(port=str(port), name=R3.name, is_uno=True)])

    assert board == SerialBoard(port=str(link), name=R3.name, is_uno=True)


def test_usb_ids_determine_the_names_of_boards(monkeypatch: pytest.MonkeyPatch) -> None:
    from serial.tools.list_ports_common import ListPortInfo

    def port(device: str, vid: int | None, pid: int | None, text: str) -> ListPortInfo:
        info = ListPortInfo(device)
        info.vid, info.pid, info.description = vid, pid, text
        return info

    ports = [
        port("/dev/ttyUSB0", 0x1A86, 0x7523, "USB Serial"),
        port("/dev/ttyS0", None, None, "ttyS0"),
        port("/dev/ttyACM1", 0x2E8A, 0x000A, "Pico"),
        port("/dev/ttyACM0", 0x2341, 0x0043, "ttyACM0"),
        port("/dev/null", 0x2341, 0x8036, "ttyACM2"),
    ]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)

    assert avrdude.usb_boards() == [LEONARDO, R3, PICO, CH340]


@pytest.mark.parametrize(
    ("said", "meaning"),
    [
        # avrdude 7.1
        ("avrdude warning: attempt 3 of 3: not in sync: resp=0x00\n", "does not answer"),
        ("avrdude error: protocol expects OK byte 0x10 but got 0x14\n", "does not answer"),
        # avrdude 6.3
        ("avrdude: stk500_getsync() attempt 10 of 10: not in sync: resp=0x00\n", "does not answer"),
        ("avrdude: verification error; content mismatch\n", "differs from the written program"),
        # another
        (
            "avrdude error: cannot open x\n\navrdude done.  Thank you.\n",
            "printed: avrdude error: c",
        ),
    ],
)
def test_each_failure_of_avrdude_becomes_a_line(said: str, meaning: str) -> None:
    """Versions of Debian 12 and Ubuntu 22.04."""
    assert meaning in avrdude.reason(said)


def test_avrdude_without_a_port_becomes_a_line(tmp_path: Path) -> None:
    call = avrdude.command(str(avrdude.find()), port=str(tmp_path / "no"), image=image_path())

    with pytest.raises(OperationError, match="boot loader does not answer"):
        avrdude.write(call, lambda done, total, name: None)


@pytest.mark.exhaustive
def test_ctrl_c_reports_an_incomplete_program() -> None:
    program = [sys.executable, "-m", "armrig", "flash", "--yes", "--port"]
    with Uno(_another_firmware) as uno:
        uno.falls_silent_at = 1024
        flash = subprocess.Popen([*program, uno.port], stderr=subprocess.PIPE, text=True)
        while not uno.written and flash.poll() is None:
            time.sleep(0.01)
        flash.send_signal(signal.SIGINT)
        _, said = flash.communicate(timeout=60)
        with avrdude.lock_port(SerialBoard(port=uno.port, name="", is_uno=True)):
            users = subprocess.run(["pgrep", "-f", f"avrdude.*{uno.port} "], capture_output=True)

    assert flash.returncode == 130
    assert "interrupted; the program may be incomplete" in said
    assert users.stdout == b""


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("", (0, 50, "asking the boot loader")),
        ("Reading | " + 50 * "#" + " | 100% 0.00s\n", (0, 50, "asking the boot loader")),
        ("Reading | #### | 100%\nWriting | " + 7 * "#", (7, 50, "writing")),
        ("Writing | " + 50 * "#" + " | 100% 3 s\nReading | ###", (3, 50, "reading back")),
        ("Writing | " + 50 * "#" + " |\nVerifying | " + 9 * "#", (9, 50, "reading back")),
    ],
)
def test_the_progress_is_read_from_the_newest_bar(said: str, told: tuple[int, int, str]) -> None:
    """A block is a fiftieth."""
    assert avrdude.progress(said) == told


@pytest.mark.parametrize("name", ["uno", "tclab", "heatshield", "optoshield"])
def test_an_image_is_selected_by_its_name(
    name: str, capsys: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(avrdude, "find", lambda: "avrdude")
    monkeypatch.setattr(avrdude, "usb_boards", lambda: [])

    assert main(["flash", "--image", name, "--port", "/dev/null", "--dry-run"]) == 0

    assert f"{image_path(name)}\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--image", "motoshield"], "the names are uno, tclab, heatshield, optoshield"),
        (["--image", "tclab", "--hex", "a.hex"], "--image and --hex exclude each other"),
    ],
)
def test_a_wrong_choice_of_the_image_is_refused(
    options: list[str], said: str, capsys: Said
) -> None:
    assert main(["flash", *options, "--dry-run"]) != 0
    assert said in capsys.readouterr().err


def test_a_firmware_that_does_not_fit_is_refused(tmp_path: Path, capsys: Said) -> None:
    """The boot loader's own 512 B are not overwritten."""
    path = tmp_path / "a.hex"
    path.write_text("".join(_records(bytes(32257))) + ":00000001FF\n", encoding="ascii")

    assert main(["flash", "--hex", str(path), "--dry-run"]) == 1
    assert "32257 B, but an ATmega328P has room for 32256" in capsys.readouterr().err
