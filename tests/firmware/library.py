"""The C core as a library, called by ctypes: one build for each set of constants."""

from __future__ import annotations

import ctypes
import fcntl
import subprocess
from collections.abc import Callable
from ctypes import c_bool, c_char_p, c_int64, c_size_t, c_uint8, c_uint16, c_uint32
from functools import cache
from pathlib import Path
from typing import Any

from armrig_daemon.emulator.firmware import Hardware

FIRMWARE = Path(__file__).parents[2] / "firmware_protocol" / "firmware"
SENT_BYTES = 1 << 14
_BYTES = ctypes.POINTER(c_uint8)
_WORLD: tuple[tuple[str, Any, tuple[Any, ...]], ...] = (
    ("read", c_uint16, (c_int64, c_uint8)),
    ("drive", None, (c_int64, c_uint16, c_uint16)),
    ("release", None, (c_int64,)),
    ("supply", c_uint16, (c_int64,)),
    ("token", c_uint32, ()),
    ("arrives", None, (c_int64, _BYTES, c_uint32)),
    ("changed", None, (c_int64, c_uint8)),
)
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "pc_bytes": (c_size_t, ()),
    "pc_move": (c_size_t, (c_char_p, c_bool)),
    "pc_device_begin": (None, (ctypes.c_void_p,)),
    "pc_device_receive": (None, (c_int64, c_char_p, c_uint32)),
    "pc_device_advance": (c_uint32, (c_int64, c_bool)),
    "pc_device_busy_ns": (c_int64, ()),
    "pc_state": (c_uint8, ()),
    "pc_cause": (c_uint8, ()),
    "pc_u_seq": (c_uint16, ()),
    "pc_next": (c_uint32, ()),
    "pc_set_next": (None, (c_uint32,)),
    "pc_set_boot_id": (None, (c_uint32,)),
    "pc_spoil_next": (None, (c_uint16,)),
    "pc_lose": (None, (c_uint16,)),
    "pc_receive": (None, (c_char_p, c_uint16)),
    "pc_open": (ctypes.c_int, (c_char_p, c_uint8, c_char_p)),
    "pc_close": (c_uint8, (c_char_p, c_uint8, c_char_p)),
    "pc_frames": (c_uint32, ()),
    "pc_spoilt": (c_uint32, ()),
    "pc_rx_lost": (c_uint16, ()),
    "pc_tx_dropped": (c_uint16, ()),
    "rig_converted": (None, (c_uint8, c_uint32)),
    "rig_poll": (None, ()),
    "rig_reading": (None, (c_uint8, c_uint16)),
    "rig_crc": (c_uint32, (c_char_p, c_uint8)),
    "rig_stuff": (None, (c_char_p, c_uint8)),
    "rig_unstuff": (c_bool, (c_char_p, c_uint8)),
    "rig_duty": (c_uint16, (c_uint16,)),
    "rig_code": (c_uint16, (c_uint16,)),
}


class Timer(ctypes.Structure):
    """The timer of scheduled mode, as `emulator.clock.Timer`."""

    _fields_ = [
        (name, c_int64) for name in ("first_ns", "period_ns", "lead_ns", "hold_ns", "k_stop", "k")
    ]


class CoreState(ctypes.Structure):
    """The beginning of `struct pc_device`."""

    _fields_ = [
        ("next_ns", c_int64),
        ("reset_ns", c_int64),
        ("second_ns", c_int64),
        ("timer", Timer),
        ("pending_k", c_uint32),
        ("pending_count", c_uint32),
        ("pending_seq", c_uint16),
        ("is_timed", c_uint8),
        ("is_watched", c_uint8),
        ("is_booting", c_uint8),
        ("has_failed", c_uint8),
    ]


class Setup(ctypes.Structure):
    """`struct pc_setup`."""

    _fields_ = [
        ("now_ns", c_int64),
        ("reset_ns", c_int64),
        ("second_ns", c_int64),
        ("boot_ns", c_int64),
        ("conversion_ns", c_int64),
        ("hold_ns", c_int64),
        ("baud", c_uint32),
        ("boot_id", c_uint32),
        ("reset_flags", c_uint8),
        ("is_watched", c_uint8),
    ]


@cache
def build(target: str, *constants: str) -> Path:
    """Return what `make` in boards/pc builds as `target`, with constants like "BOARD_QUEUE=256".

    It stays in the checkout, and all processes that test the core take it from there.
    """
    here = FIRMWARE / "boards" / "pc"
    # Not with a "=" in its name: make would take the target for a variable, and build everything.
    name = "-".join(one.replace("=", "-") for one in constants) or "as-it-is"
    out = here / "build" / name
    out.mkdir(parents=True, exist_ok=True)
    flags = " ".join(f"-D{one}" for one in constants)
    command = ["make", "-C", str(here), f"OUT={out}", f"CONSTANTS={flags}", f"{out}/{target}"]
    with (out / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # a second process waits for the first one's build
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the C core is not built:\n{done.stderr}")
    return out / target


class Library:
    """One build of the core. It has one state, which is swapped where several devices use it."""

    def __init__(self, path: Path) -> None:
        """Load it, and connect it with its user."""
        self.functions = c = ctypes.CDLL(str(path))
        for name, (kind, given) in _FUNCTIONS.items():
            function = getattr(c, name)
            function.restype, function.argtypes = kind, given
        self.state = CoreState.in_dll(c, "pc_device")
        self.sent = (ctypes.c_char * SENT_BYTES).in_dll(c, "pc_sent")
        self._bytes = c.pc_bytes()
        self._user: Any = None
        self._error: BaseException | None = None
        kinds = [(name, ctypes.CFUNCTYPE(kind, *given)) for name, kind, given in _WORLD]
        world = type("World", (ctypes.Structure,), {"_fields_": kinds})
        self.functionsalls = [kind(self._to_user(name)) for name, kind in kinds]  # kept: C has them
        c.pc_device_connect(ctypes.byref(world(*self.functionsalls)))

    def use(self, user: Any) -> Any:
        """Return the functions, with the state of `user` in place, to whom calls go."""
        if self._user is not user:
            if self._user is not None:
                self._user.image = ctypes.create_string_buffer(self._bytes)
                self.functions.pc_move(self._user.image, True)
            if user.image is not None:
                self.functions.pc_move(user.image, False)
            self._user = user
        return self.functions

    def raise_error(self) -> None:
        """Raise the error of a call from C, because C knows no exceptions."""
        error, self._error = self._error, None
        if error is not None:
            raise error
        assert not self.state.has_failed, "C goes no further, and nobody was told why"

    def _to_user(self, name: str) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            try:
                return getattr(self._user, name)(*given)
            except BaseException as err:
                self._error = self._error or err
                self.state.has_failed = 1  # C returns as soon as it can
                return 0

        return call


@cache
def library(hardware: Hardware, target: str = "librig.so") -> Library:
    """Return the core for a board of this hardware, built as `target` of boards/pc."""
    constants = {
        "BOARD_QUEUE": hardware.queue,
        "BOARD_ADC_BITS": hardware.adc_bits,
        "BOARD_PWM_BITS": hardware.pwm_bits,
        "BOARD_SKEW_US": hardware.skew_us,
        "BOARD_TS_MIN_US": hardware.ts_min_us,
    }
    return _loaded(build(target, *(f"{key}={value}" for key, value in constants.items())))


@cache
def _loaded(path: Path) -> Library:
    # A library that is loaded twice is one in memory, and calls the last user.
    return Library(path)
