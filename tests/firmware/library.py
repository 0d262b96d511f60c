"""The C core as a library: built once per process for each set of constants; called by ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from armrig_daemon.emulator.firmware import Hardware

FIRMWARE = Path(__file__).parents[2] / "firmware_protocol" / "firmware"
PC = FIRMWARE / "boards" / "pc"
U8, U16, U32, BOOL = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_bool
_CALLS: tuple[tuple[str, Any, tuple[Any, ...]], ...] = (
    ("motor_off", None, ()),
    ("motor_set", None, (U16,)),
    ("convert_now", None, ()),
    ("timer_start", None, (U32, U32, U32)),
    ("timer_stop", None, ()),
    ("converter_is_free", BOOL, ()),
    ("convert_channel", None, (U8, U16)),
    ("measure_supply_now", None, ()),
    ("send", BOOL, (ctypes.POINTER(U8), U8)),
    ("send_us", U32, ()),
    ("token", U32, ()),
)
_RETURNS = {
    "pc_state_bytes": ctypes.c_size_t,
    "pc_fed_us": U32,
    "pc_asked_k": U32,
    "pc_next": U32,
    "rig_crc": U32,
    "rig_unstuff": BOOL,
    "rig_duty": U16,
    "rig_code": U16,
    "pc_frames": U32,
    "pc_spoilt": U32,
}
_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "pc_reset": (U32, U8),
    "pc_set_time": (U32,),
    "pc_set_next": (U32,),
    "pc_set_boot_id": (U32,),
    "pc_spoil_next": (U16,),
    "pc_lose": (U16,),
    "pc_receive": (ctypes.c_char_p, U16),
    "rig_reading": (U8, U16),
    "rig_latch": (U8,),
    "pc_converted": (U8, U32),
    "rig_supply": (U16,),
    "rig_crc": (ctypes.c_char_p, U8),
    "rig_stuff": (ctypes.c_char_p, U8),
    "rig_unstuff": (ctypes.c_char_p, U8),
    "rig_duty": (U16,),
    "rig_code": (U16,),
    "pc_open": (ctypes.c_char_p, U8, ctypes.c_char_p),
    "pc_close": (ctypes.c_char_p, U8, ctypes.c_char_p),
}


def missing() -> str:
    """Return what the tests of the C core lack here; empty where nothing."""
    wanted = [name for name in ("cc", "make") if shutil.which(name) is None]
    return f"no {' and no '.join(wanted)}: the C core is not built" if wanted else ""


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="armrig-firmware-")


@cache
def build(target: str, *constants: str, firmware: Path = FIRMWARE) -> Path:
    """Return what `make` in boards/pc builds as `target`, with constants like "BOARD_QUEUE=256"."""
    out = Path(_folder().name, str(abs(hash((target, constants, firmware)))))
    out.mkdir(exist_ok=True)
    flags = " ".join(f"-D{one}" for one in constants)
    command = ["make", "-C", str(firmware / "boards" / "pc"), f"OUT={out}", f"CONSTANTS={flags}"]
    done = subprocess.run(
        [*command, f"{out}/{target}"], capture_output=True, text=True, check=False
    )
    if done.returncode:
        msg = f"the C core is not built:\n{done.stderr}"
        raise RuntimeError(msg)
    return out / target


class User(Protocol):
    """Who answers the calls of the board layer."""

    image: ctypes.Array[ctypes.c_char] | None
    """The core's state while another's is in the library."""


class Library:
    """One build of the core. It has one state, which is swapped where several devices use it."""

    def __init__(self, path: Path) -> None:
        """Load it, and plug in calls that go to whoever uses it."""
        self.c = ctypes.CDLL(str(path))
        for name, kind in _RETURNS.items():
            getattr(self.c, name).restype = kind
        for name, kinds in _ARGUMENTS.items():
            getattr(self.c, name).argtypes = kinds
        self._bytes = self.c.pc_state_bytes()
        self.user: Any = None
        self.error: BaseException | None = None
        kinds = [ctypes.CFUNCTYPE(result, *given) for _, result, given in _CALLS]
        names = [name for name, _, _ in _CALLS]
        fields = list(zip(names, kinds, strict=True))
        table = type("Calls", (ctypes.Structure,), {"_fields_": fields})
        self._calls = [kind(self._to_user(name)) for name, kind in fields]
        self.c.pc_plug(ctypes.byref(table(*self._calls)))

    def use(self, user: User) -> Any:
        """Return the library with the state of `user` in it, to whom its calls go."""
        if self.user is not user:
            if self.user is not None:
                self.user.image = ctypes.create_string_buffer(self._bytes)
                self.c.pc_save(self.user.image)
            if user.image is not None:
                self.c.pc_load(user.image)
            self.user = user
        return self.c

    def raise_error(self) -> None:
        """Raise what a call of the core has met: C knows no exceptions."""
        error, self.error = self.error, None
        if error is not None:
            raise error

    def _to_user(self, name: str) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            try:
                return getattr(self.user, name)(*given)
            except BaseException as err:
                self.error = self.error or err
                return 0

        return call


@cache
def library(hardware: Hardware) -> Library:
    """Return the core for a board of this hardware."""
    constants = {
        "BOARD_QUEUE": hardware.queue,
        "BOARD_ADC_BITS": hardware.adc_bits,
        "BOARD_PWM_BITS": hardware.pwm_bits,
        "BOARD_SKEW_US": hardware.skew_us,
        "BOARD_TS_MIN_US": hardware.ts_min_us,
    }
    return Library(build("librig.so", *(f"{key}={value}" for key, value in constants.items())))
