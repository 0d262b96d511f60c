"""Check of a configuration by the device (PROTOCOL.md, section 4)."""

from __future__ import annotations

from armrig_protocol.messages import (
    WATCHDOG_MAX_MS,
    WATCHDOG_MIN_MS,
    Code,
    Config,
    Mode,
    Underrun,
)

HEADER_FIELDS = 2
NONE_IN_FORCE = (0,) * (len(Config._fields) - HEADER_FIELDS)


def check_config(config: Config, *, ts_min_us: int, skew_us: int) -> Code:
    """Return OK, or the code with which this device refuses `config`.

    Parameters
    ----------
    ts_min_us, skew_us : int
        Values of HELLO_R.
    """
    pairs_more = config.oversampling - 1
    allowed = (
        config.ts_us >= ts_min_us + 2 * pairs_more * skew_us
        and config.u_min <= config.u_max
        # The device has an enable line, so u_rest may differ from 0.
        and (config.u_rest == 0 or config.u_min <= config.u_rest <= config.u_max)
        and WATCHDOG_MIN_MS <= config.watchdog_ms <= WATCHDOG_MAX_MS
        and config.mode in set(Mode)
        and config.underrun in set(Underrun)
        and config.oversampling >= 1
    )
    return Code.OK if allowed else Code.BAD_VALUE
