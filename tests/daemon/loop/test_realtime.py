"""Privileges of a loop, in processes of their own, and the refusals of a sandbox."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_FILTER = """
import ctypes, struct
def refuse(*numbers):
    "Have these system calls fail with EPERM, as systemd's filters do."
    libc = ctypes.CDLL(None, use_errno=True)
    code = struct.pack("HBBI", 0x20, 0, 0, 0)
    for i, number in enumerate(numbers):
        code += struct.pack("HBBI", 0x15, len(numbers) - i, 0, number)
    code += struct.pack("HBBI", 0x06, 0, 0, 0x7FFF0000) + struct.pack("HBBI", 0x06, 0, 0, 0x50001)
    text = ctypes.create_string_buffer(code)
    class Program(ctypes.Structure):
        _fields_ = [("n", ctypes.c_ushort), ("code", ctypes.c_void_p)]
    program = Program(len(code) // 8, ctypes.addressof(text))
    assert libc.prctl(38, 1, 0, 0, 0) == 0
    assert libc.prctl(22, 2, ctypes.byref(program), 0, 0) == 0, ctypes.get_errno()
"""
_SETPARAM, _SETSCHEDULER = 142, 144  # of x86-64


def _granted() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


pytestmark = [
    pytest.mark.root,
    pytest.mark.skipif(not _granted(), reason="SCHED_FIFO is not granted to this user"),
    pytest.mark.skipif(os.uname().machine != "x86_64", reason="the filter's numbers are x86-64's"),
]


def _run(program: str) -> str:
    """Return the output of a program that begins at SCHED_FIFO 1, as systemd's unit has it."""
    begin = "import os\nos.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))\n"
    program = f"{begin}from armrig_core.process import realtime\n{_FILTER}{program}"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


_LOOP = """
given = realtime.prepare(80, None)
print(given["fifo"], os.sched_getscheduler(0) == os.SCHED_FIFO, os.sched_getparam(0).sched_priority)
print([line for line in given["refused"] if "priority" in line or "FIFO" in line])
"""


def test_a_scheduling_policy_set_by_systemd_is_kept_and_reported() -> None:
    """RestrictRealtime= prevents a request for it."""
    assert _run(f"refuse({_SETSCHEDULER}){_LOOP}") == "80 True 80\n[]"


def test_an_unchangeable_priority_is_reported_with_its_value() -> None:
    said = _run(f"refuse({_SETSCHEDULER}, {_SETPARAM}){_LOOP}")

    assert said == "1 True 1\n['priority 80 (it is 1; set LimitRTPRIO=80)']"


def test_a_priority_of_0_restores_the_ordinary_policy() -> None:
    assert _run('print(realtime.prepare(0, None)["fifo"], os.sched_getscheduler(0))') == "0 0"


def test_all_threads_of_the_service_leave_the_real_time_policy() -> None:
    """Threads of numpy's libraries begin before, and would spin at the loop's priority."""
    threads = """
import threading
ends = threading.Event()
thread = threading.Thread(target=ends.wait)
thread.start()
print(realtime.leave_fifo(), os.sched_getscheduler(0), os.sched_getscheduler(thread.native_id))
ends.set()
"""
    assert _run(threads) == "True 0 0"


def test_the_thread_of_the_parent_death_signal_keeps_a_priority() -> None:
    threads = """
import threading
ends = threading.Event()
kept, other = (threading.Thread(target=ends.wait) for _ in range(2))
kept.start(), other.start()
policies = lambda: [os.sched_getscheduler(t.native_id) for t in (kept, other)]
realtime.leave_fifo(but=kept.native_id)
given = policies()
os.sched_setscheduler(kept.native_id, os.SCHED_OTHER, os.sched_param(0))
realtime.be_prompt(kept.native_id)
print(given, policies(), os.sched_getparam(kept.native_id).sched_priority)
ends.set()
"""
    assert _run(threads) == "[1, 0] [1, 0] 1"


def test_a_thread_without_its_priority_continues() -> None:
    threads = f"""
import threading
ends = threading.Event()
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
thread = threading.Thread(target=ends.wait)
thread.start()
refuse({_SETSCHEDULER})
realtime.be_prompt(thread.native_id)
print(os.sched_getscheduler(thread.native_id))
ends.set()
"""
    assert _run(threads) == "0"


def test_a_service_that_cannot_leave_the_real_time_policy_continues() -> None:
    assert _run(f"refuse({_SETSCHEDULER})\nprint(realtime.leave_fifo())") == "False"
