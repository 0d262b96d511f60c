"""The Python firmware and the C core answer every byte alike."""

from __future__ import annotations

import os
from typing import Any
from zlib import crc32

from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.cobs import stuff
from armrig_protocol.messages import (
    SCHEMA_HASH,
    VERSION,
    Arm,
    Cal,
    ClearFault,
    Config,
    Estop,
    Exchange,
    Hello,
    Keepalive,
    Mode,
    Ping,
    Pong,
    Setpoints,
    Start,
    Stop,
)
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from tests.firmware.both_devices import MS, US, BothDevices
from tests.tools import needs

pytestmark = needs("cc", "make")

EXAMPLES = int(os.environ.get("ARMRIG_FIRMWARE_EXAMPLES", "40"))
BENCHES = [
    EmulatorSettings(boot_ms=1.0),
    EmulatorSettings(boot_ms=1.0, baud=1_000_000, pwm_bits=0, adc_bits=0, queue=64),
    EmulatorSettings(boot_ms=1.0, clock_ppm=37.5, queue=256, brown_out_s=0.35),
    EmulatorSettings(boot_ms=0.0, baud=1_000_000, supply_v=3.9, adc_noise_v=0.0),
    EmulatorSettings(boot_ms=5.0, theta_1_zero_deg=2.0, alpha_zero_deg=0.0, queue=256),
]
CODES = st.one_of(st.integers(0, 65535), st.sampled_from([0, 1, 999, 1000, 1001, 65535]))
U32 = st.integers(0, 2**32 - 1)
WAITS = st.one_of(
    st.integers(0, 3 * MS),
    st.sampled_from([0, 20 * US, 104 * US, 208 * US, 320 * US, 1 * MS, 30 * MS, 120 * MS]),
)
SOUND_CONFIGS = st.fixed_dictionaries(
    {
        "ts_us": st.sampled_from([208, 500, 1000, 1000, 3000]),
        "u_min": st.sampled_from([0, 0, 0, 500]),
        "u_max": st.sampled_from([65535, 65535, 30000, 1000]),
        "u_rest": st.sampled_from([0, 0, 700]),
        "slew": st.sampled_from([0, 0, 1000, 30000]),
        "watchdog_ms": st.sampled_from([20, 100, 250]),
        "mode": st.sampled_from([Mode.EXCHANGE, Mode.SCHEDULED]),
        "underrun": st.sampled_from([0, 1]),
        "hold": st.sampled_from([0, 1, 3, 255]),
        "oversampling": st.sampled_from([1, 1, 1, 2, 3, 7]),
        "rail_ticks": st.sampled_from([0, 0, 1, 5, 30]),
        "turns": st.sampled_from([0, 0, 1, 10, 50]),
    }
)
FIELDS = {
    "ts_us": U32,
    "u_min": CODES,
    "u_max": CODES,
    "u_rest": CODES,
    "slew": CODES,
    "watchdog_ms": st.sampled_from([0, 19, 20, 250, 251, 65535]),
    "mode": st.integers(0, 3),
    "underrun": st.integers(0, 3),
    "hold": st.integers(0, 255),
    "oversampling": st.integers(0, 255),
    "rail_ticks": CODES,
    "turns": CODES,
}
ANY_CONFIGS = st.one_of(
    st.fixed_dictionaries(FIELDS),
    # One field that may be off, the others sound.
    *(
        st.builds(lambda sound, value, key=key: {**sound, key: value}, SOUND_CONFIGS, values)
        for key, values in FIELDS.items()
    ),
)
OFTEN = st.sampled_from([True, True, False])
MOSTLY = st.sampled_from([True] * 7 + [False])
STEPS = st.sampled_from([1, 1, 1, 1, 1, 1, 2, 1000, 0, -1, 2**31 - 1, 2**31])
SHIFTS = st.sampled_from([0, 0, 0, 0, 0, -1, -30, 1, 3, 2**31, 2**32 - 5])
PAUSES = st.sampled_from([0, 104 * US, 320 * US, 500 * US, 700 * US, 1 * MS])


class SameAnswers(RuleBasedStateMachine):
    """Any frames of a host, a line, or an attacker with an old recording.

    There are few rules, each with many cases, because the motor must be driven most of the time.
    """

    @initialize(bench=st.sampled_from(BENCHES), now=MOSTLY)
    def switch_on(self, bench: EmulatorSettings, now: bool) -> None:
        self.both = BothDevices(bench)
        self.config: dict[str, Any] = {}
        if now:
            self.both.wait(10 * MS)

    @rule(dt_ns=WAITS)
    def wait(self, dt_ns: int) -> None:
        self.both.wait(dt_ns)

    @rule(
        config=SOUND_CONFIGS,
        far=st.sampled_from([1, 2, 3, 3, 3, 3]),
        k_stop=st.sampled_from([0, 0, 0, 1, 5, 40]),
    )
    def go(self, config: dict[str, Any], far: int, k_stop: int) -> None:
        """Go the way of a host up to READY, ARMED or RUN, from wherever."""
        both = self.both
        both.put(Stop)
        both.put(Hello, version=VERSION, schema=SCHEMA_HASH)
        both.wait(3 * MS)
        both.put(ClearFault, token=both.token)
        both.k = 0
        self.config = config
        both.put(Config, **config)
        both.wait(3 * MS)
        if far > 1:
            both.put(Arm, boot_id=both.boot_id, config_crc=both.config_crc, nonce=both.nonce)
            both.wait(1 * MS)
        if far > 2:
            if config["mode"] == Mode.SCHEDULED:
                self.supply(0, [self._within(0)] * 24)
            both.put(Start, k_stop=k_stop * config["mode"], nonce=both.nonce)
            both.wait(1 * MS)

    @rule(codes=st.lists(CODES, min_size=1, max_size=24), ticks=st.integers(1, 60), flat=MOSTLY)
    def drive(self, codes: list[int], ticks: int, flat: bool) -> None:
        """Drive as a host does, in either mode; with codes that are in range."""
        if not self.config:
            return
        sent = [self._within(codes[0] if flat else code) for code in codes]
        if self.config["mode"] == Mode.SCHEDULED:
            for _ in range(ticks // 3 + 1):
                self.supply(self.both.held, sent)
                self.both.wait(1300 * US)
            return
        for i in range(ticks):
            self.both.k = (self.both.k + 1) & 0xFFFFFFFF
            self.both.put(Exchange, k=self.both.k, u=sent[i % len(sent)])
            self.both.wait(1 * MS)

    @rule(
        steps=st.lists(STEPS, max_size=8),
        codes=st.lists(CODES, min_size=8, max_size=8),
        sound=OFTEN,
        dt_ns=PAUSES,
    )
    def exchange(self, steps: list[int], codes: list[int], sound: bool, dt_ns: int) -> None:
        """Send EXCHANGE frames in quick succession, out of range, and with a k not ahead."""
        both = self.both
        for step, code in zip(steps, codes, strict=False):
            both.k = (both.k + step) & 0xFFFFFFFF
            both.put(Exchange, k=both.k, u=self._within(code) if sound and self.config else code)
            both.wait(dt_ns)

    @rule(
        shift=SHIFTS,
        codes=st.lists(CODES, min_size=1, max_size=24),
        flat=MOSTLY,
        sound=OFTEN,
        times=st.sampled_from([1, 1, 3, 30]),
    )
    def setpoints(self, shift: int, codes: list[int], flat: bool, sound: bool, times: int) -> None:
        """Send frames that follow the last, overlap it, leave a gap, disagree, or overflow."""
        for _ in range(times):
            sent = [codes[0]] * len(codes) if flat else codes
            if sound and self.config:
                sent = [self._within(code) for code in sent]
            self.supply((self.both.held + shift) & 0xFFFFFFFF, sent)
            self.both.wait(20 * US)

    @rule(data=st.data(), nonce=MOSTLY, wrong=U32)
    def ask(self, data: st.DataObject, nonce: bool, wrong: int) -> None:
        """Send any other request, right or wrong."""
        both = self.both
        kind = data.draw(st.sampled_from([Config, Arm, Start, ClearFault, Cal, Cal, Setpoints]))
        if kind is Config:
            both.put(Config, **data.draw(ANY_CONFIGS))
        elif kind is Arm:
            boot_id = both.boot_id if data.draw(MOSTLY) else wrong
            config_crc = both.config_crc if data.draw(MOSTLY) else wrong
            own = both.nonce if nonce else wrong
            both.put(Arm, boot_id=boot_id, config_crc=config_crc, nonce=own)
        elif kind is Start:
            k_stop = data.draw(st.sampled_from([0, 0, 1, 2, 2**32 - 1]))
            both.put(Start, k_stop=k_stop, nonce=both.nonce if nonce else wrong)
        elif kind is ClearFault:
            both.put(ClearFault, token=both.token if nonce else wrong)
        elif kind is Cal:
            n = data.draw(st.sampled_from([0, 1, 2, 3, 3, 50, 1024, 1025]))
            channel, zero = data.draw(st.sampled_from([(0, 0), (1, 0), (1, 0), (2, 0), (0, 1)]))
            both.put(Cal, channel=channel, zero=zero, n=n)
        else:
            n, zero = data.draw(st.sampled_from([(0, 0), (24, 1), (25, 0), (255, 0), (24, 0)]))
            u = tuple(data.draw(st.lists(CODES, min_size=24, max_size=24)))
            both.put(Setpoints, k0=both.held, n=n, zero=zero, u=u)

    @rule(
        kind=st.sampled_from([Stop, Estop, Keepalive, Keepalive, Hello, Ping, Ping, None]),
        back=st.sampled_from([0, 0, 0, 5]),
        word=st.integers(0, 65535),
    )
    def say(self, kind: Any, back: int, word: int) -> None:
        """Frames that are taken in every state, some with a seq that is not newer; or a reset."""
        seq = (self.both.seq - back) & 0xFFFF if back else None
        if kind is Hello:
            self.both.put(Hello, seq=seq, version=word, schema=SCHEMA_HASH)
        elif kind is Ping:
            self.both.put(Ping, seq=seq, host_ns=word << 40 | word)
        elif kind is not None:
            self.both.put(kind, seq=seq)
        elif word % 4 == 0:
            self.both.reset()
            self.both.wait(6 * MS)

    @rule(data=st.data(), noise=st.binary(max_size=150))
    def disturb(self, data: st.DataObject, noise: bytes) -> None:
        """Play again, flip, cut, jump in seq, or send what no host sends."""
        both = self.both
        what = data.draw(st.sampled_from(["again", "again", "flip", "cut", "jump", "noise", "odd"]))
        wire = data.draw(st.sampled_from(both.sent)) if both.sent else b"\0"
        if what == "again":
            both.write(wire)
        elif what == "flip":
            at = data.draw(st.integers(0, 8 * len(wire) - 1))
            both.write(flipped(wire, at))
        elif what == "cut":
            cut = data.draw(st.integers(0, len(wire)))
            both.write(wire[:cut])
            both.wait(data.draw(st.sampled_from([0, 50 * US, 1 * MS])))
            both.write(wire[cut:])
        elif what == "jump":
            ahead = data.draw(st.sampled_from([1, 2, 32766, 32767, 32768, 40000, 65535]))
            both.seq = (both.seq + ahead) & 0xFFFF
        elif what == "noise":
            both.write(noise)
        else:  # a right CRC over anything: an unknown type, or a known one of a wrong length
            kind = data.draw(st.sampled_from([b"", b"\x05", b"\x10", b"\x90", b"\x84"]))
            text = kind + noise[:59] + b"end"
            both.write(stuff(text + crc32(text).to_bytes(4, "little")) + b"\0")
            both.put(Pong, host_ns=1, rx_us=2, tx_us=3)

    def supply(self, k0: int, codes: list[int]) -> None:
        """Send setpoints, and note where they end."""
        u = (*codes, *(0,) * (24 - len(codes)))
        self.both.put(Setpoints, k0=k0, n=len(codes), zero=0, u=u)
        self.both.held = (k0 + len(codes)) & 0xFFFFFFFF

    def _within(self, code: int) -> int:
        """Return a code that the configuration allows after u_rest."""
        low, high, slew = (self.config[key] for key in ("u_min", "u_max", "slew"))
        if slew:
            low = max(low, self.config["u_rest"] - slew // 2)
            high = min(high, low + slew // 2)
        return low + code % (high - low + 1)

    def teardown(self) -> None:
        """Let pending work come to its end, the watchdog included."""
        if hasattr(self, "both"):
            self.both.wait(1200 * MS)


def flipped(wire: bytes, at: int) -> bytes:
    """Return `wire` with one bit flipped."""
    spoilt = bytearray(wire)
    spoilt[at // 8] ^= 1 << at % 8
    return bytes(spoilt)


def test_the_c_and_python_devices_answer_every_byte_identically() -> None:
    """In both modes, with all guards; at the same nanosecond."""
    run_state_machine_as_test(
        SameAnswers,
        settings=settings(
            max_examples=EXAMPLES,
            stateful_step_count=40,
            suppress_health_check=list(HealthCheck),
        ),
    )
