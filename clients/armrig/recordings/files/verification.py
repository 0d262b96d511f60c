"""Verification that a recording reports all its gaps and contains only requested voltages.

A recording that fails the verification can still be loaded and exported. Only an exchanged
attachment is refused by `load`, and so by `verify`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from armrig_core.commands.codes import OutcomeCode
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import CONFIG
from armrig_core.recording_file.part_names import part_number
from armrig_core.rig.volts import U_MAX_V
from armrig_protocol.messages import CODE_FULL_SCALE

from armrig.data.columns import Vector
from armrig.data.files.imported_file import ImportedData
from armrig.data.finding import Finding, good, unusable, warning
from armrig.numerics.quantities import NBSP, digits, join_names, plural
from armrig.recordings.files.attachment_hashes import attachment_fault, attachment_names
from armrig.recordings.files.control_run import (
    ControlRun,
    OwnControlRun,
    control_run,
    own_control_run,
)
from armrig.recordings.files.imports import load_import
from armrig.recordings.files.input_attachment import read_input
from armrig.recordings.files.loading import beginning, load
from armrig.recordings.files.recording_names import path_of_name
from armrig.recordings.files.recording_summary import REMOTE
from armrig.recordings.jitter import sampling_statistics
from armrig.recordings.recording import Recording

_CODE_V = U_MAX_V / CODE_FULL_SCALE
"""Voltage step of one code, in V; requested voltages are rounded to multiples of this step."""
MAX_DRIFT_PPM = 6_000.0
"""Largest drift, in ppm. A ceramic resonator is accurate to 5 000 ppm, a crystal to 100 ppm."""
_MAX_JUMP_SIGMAS = 6.0


RESULTS: Mapping[str, str] = {"good": "passed", "warning": "not checked", "unusable": "failed"}
"""Result of a check, by the level of its finding.

A recording without the data that a check needs is not checked.
"""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Verification:
    """Result of `verify`; its repr is a table."""

    path: Path
    """Path of the recording."""
    sha256: str
    """Hash of the recording, as `sha256sum` prints it."""
    checks: tuple[Finding, ...]
    """Findings on file, samples, envelope, input, timing, configuration, attachments and clock."""
    samples: int = 0
    """Number of samples that could be read."""

    @property
    def passed(self) -> bool:
        """True if no check failed."""
        return all(check.level != "unusable" for check in self.checks)

    def __repr__(self) -> str:
        """Return a row for each check."""
        width = max(len(check.about) for check in self.checks)
        return "\n".join(f"{c.about:{width}}  {RESULTS[c.level]:11}  {c.text}" for c in self.checks)


def verify(path: str | Path) -> Verification:
    """Check that the samples of a recording agree with the other data in the recording.

    The path is a path as for `load`. Raises the errors of `load`.
    """
    file = path_of_name(path)
    data = load_import(file)
    return verify_recording(load(path)) if data is None else _verify_import(file, data)


def _verify_import(file: Path, data: ImportedData) -> Verification:
    """Return the result for imported data, whose reading has checked their hash."""
    rows, sha256 = plural(len(data.at), "row"), hashlib.sha256(file.read_bytes()).hexdigest()
    text = f"complete, {rows} as imported, by their hash {data.sha256[:12]}"
    return Verification(
        path=file, sha256=sha256, checks=(good("file", text),), samples=len(data.at)
    )


def verify_recording(recording: Recording) -> Verification:
    """Check a loaded recording, as `verify` does."""
    if (data := load_import(recording.path)) is not None:
        return _verify_import(recording.path, data)
    checks = (
        check_file(recording),
        check_samples(recording),
        check_envelope(recording),
        _check_attached_input(recording),
        check_timing(recording),
        _check_configuration(recording),
        _check_attachments(recording),
        check_clock(recording),
    )
    return Verification(
        path=recording.path, sha256=recording.sha256, checks=checks, samples=recording.samples.size
    )


def check_file(r: Recording) -> Finding:
    """Check that the file is complete, and that checksums and number of samples are right."""
    if r.truncated:
        return unusable("file", r.damage)
    if r.outcome is None:
        return unusable("file", "it does not contain the outcome of the run")
    whole_run = r.manifest.part > 0 and not part_number(r.path)
    if whole_run and r.outcome.code == OutcomeCode.CONTINUED:
        return unusable(
            "file", "its last part is missing: the previous part says that the run is continued"
        )
    count, missing = r.samples.size, r.missing
    if r.manifest.part == 0 and (r.outcome.samples, r.outcome.missing) != (count, missing):
        text = (
            f"it reports {plural(r.outcome.samples, 'sample')} and "
            f"{plural(r.outcome.missing, 'missing sample')}, "
        )
        text += "but contains "
        return unusable("file", f"{text}{count} and {missing}")
    return good("file", f"complete, all checksums correct; outcome of the run: {r.outcome.outcome}")


def check_samples(r: Recording) -> Finding:
    """Check that each missing sample is in a gap record."""
    if not r.N and r.recovered is not None:
        return unusable("samples", "the file was cut off before its first sample")
    if not r.N:
        return warning("samples", "no sample was due")
    # Gaps may overlap. The cumulative sum of `change` is the number of gaps that contain a row.
    change = np.zeros(r.N + 1, np.int64)
    for gap in r.gaps:
        for k, step in ((gap.k_first, 1), (gap.k_first + gap.count, -1)):
            change[min(max(k - r.k_first, 0), r.N)] += step
    unreported = ~r.present & (np.cumsum(change[:-1]) == 0)
    if unreported.any():
        k = r.k_first + int(unreported.argmax())
        count = int(np.count_nonzero(unreported))
        text = (
            f"{plural(count, 'sample is', 'samples are')} missing without a gap record, from "
            f"k={k} on"
        )
        return unusable("samples", text)
    if r.missing:
        text = (
            f"{r.samples.size} of {r.N}; "
            f"{plural(r.missing, 'missing sample is', 'missing samples are')} in gap records"
        )
        return good("samples", text)
    return good("samples", f"all {r.N} from k={r.k_first} on")


def check_envelope(r: Recording) -> Finding:
    """Check that no requested, applied or held voltage was outside 0 to 5 V."""
    held = np.array([gap.u_held_v for gap in r.gaps], np.float64)
    # A remote recorder does not know the voltage of a gap whose report it missed.
    is_known = ~np.isnan(held) if r.manifest.experiment == REMOTE else np.ones(held.size, np.bool_)
    volts = {
        "requested": r.samples["u_cmd_v"],
        "applied": r.samples["u_applied_v"],
        "held in a gap": held[is_known],
    }
    for name, u in volts.items():
        outside = ~((u >= 0.0) & (u <= U_MAX_V))  # NaN is outside, too
        if outside.any():
            i = int(outside.argmax())
            text = f"{u[i]:.6g} V was {name}, outside 0 to {U_MAX_V:g} V"
            if u.size == r.samples.size and name != "held in a gap":
                text += f", at k={r.samples['k'][i]}"
            return unusable("envelope", text)
    u = volts["applied"]
    if not u.size:
        return warning("envelope", "no sample")
    seen = f"{u.min():.4g} to {u.max():.4g} V applied"
    unknown = int(np.count_nonzero(~is_known))
    remark = f"; unknown in {plural(unknown, 'gap')} that the recorder missed" if unknown else ""
    return good("envelope", f"{seen}, inside 0 to {U_MAX_V:g} V{remark}")


def check_input(r: Recording, u: Vector) -> Finding:
    """Check that the voltages of each sample agree with the attached input `u`, (N,) in V."""
    at = r.samples["k"].astype(np.int64) - max(r.manifest.k_first, 0)
    if u.size != r.manifest.samples:
        text = (
            f"{plural(u.size, 'voltage is', 'voltages are')} attached, but the run has "
            f"{plural(r.manifest.samples, 'sample')}"
        )
        return unusable("input", text)
    outside = (at < 0) | (at >= u.size)
    if outside.any():
        k = r.samples["k"][outside.argmax()]
        return unusable("input", f"sample k={k} is outside the {u.size} attached voltages")
    if not at.size:
        return warning("input", "no sample")
    # A device with n bits applies the nearest of its 2^n steps.
    bits = r.manifest.device.get("pwm_bits")
    step = U_MAX_V / (1 << bits) if isinstance(bits, int) and 0 < bits <= 16 else _CODE_V
    for name, field, most in (
        ("requested", "u_cmd_v", 0.5 * _CODE_V),
        ("applied", "u_applied_v", 0.5 * step + _CODE_V),
    ):
        wrong = ~(np.abs(r.samples[field] - u[at]) <= most * (1 + 1e-9))
        if wrong.any():
            i = int(wrong.argmax())
            text = f"{plural(int(np.count_nonzero(wrong)), 'sample')} with another voltage {name}, "
            text += f"the first at k={r.samples['k'][i]}: {r.samples[field][i]:.6g} V instead of "
            return unusable("input", f"{text}{u[at[i]]:.6g} V")
    text = (
        "u is the experiment's input at each sample, applied in steps of "
        f"{digits(step * 1e3, 3)}{NBSP}mV"
    )
    return good("input", text)


def check_timing(r: Recording) -> Finding:
    """Check that the times of both clocks increase, and report jitter and lateness."""
    for name, field in (("device", "t_device_us"), ("host", "t_sched_ns")):
        t = r.samples[field].astype(np.int64)
        back = np.flatnonzero(t[1:] <= t[:-1])
        if back.size:
            k = r.samples["k"][back[0] + 1]
            return unusable("timing", f"the time of the {name}'s clock does not increase at k={k}")
    s = sampling_statistics(r)
    if not s.jitter.n:
        return warning("timing", "too few samples")
    text = ", ".join(
        f"{name} {digits(p.p50, 3)}, {digits(p.p99, 3)}, {digits(p.p999, 3)}, {digits(p.max, 3)}"
        for name, p in (("jitter", s.jitter), ("lateness", s.lateness))
    )
    return good("timing", f"{text} (p50, p99, p99.9, max in µs)")


def check_clock(r: Recording) -> Finding:
    """Check the drift of the device's clock, and that the offset of the clocks does not jump."""
    if r.samples.size < 2:
        return warning("clock", "too few samples")
    # Over the whole run, the errors of single time stamps have little effect on the drift.
    host = int(r.samples["t_sched_ns"][-1]) - int(r.samples["t_sched_ns"][0])
    device = 1000 * (int(r.samples["t_device_us"][-1]) - int(r.samples["t_device_us"][0]))
    ppm = (device / host - 1) * 1e6
    # The first and the last time may each be wrong by a sampling time.
    allowed = MAX_DRIFT_PPM + 2 * (r.Ts * 1e9) / host * 1e6
    if abs(ppm) > allowed:
        text = f"the device's clock is {ppm:.0f} ppm off the host's clock over the run; "
        text += "the limit is "
        return unusable("clock", f"{text}{allowed:.0f}")
    for before, after in pairwise(r.clock):
        change = after.offset_ns - before.offset_ns
        expected = before.drift_ppm * 1e3 * (after.t - before.t)
        spread = np.hypot(before.offset_std_ns, after.offset_std_ns)
        spread = np.hypot(spread, before.drift_std_ppm * 1e3 * (after.t - before.t))
        if (
            not abs(change - expected)
            <= _MAX_JUMP_SIGMAS * spread + before.bound_ns + after.bound_ns
        ):
            text = f"the offset of the clocks jumps by {(change - expected) / 1e3:.0f} µs at "
            text += f"{after.t:.1f} s (standard deviation {spread / 1e3:.0f} µs)"
            return unusable("clock", text)
    if not r.clock:
        return good("clock", f"the device's clock is {ppm:+.1f} ppm off; no comparisons recorded")
    last = r.clock[-1]
    text = f"{plural(len(r.clock), 'comparison')} without a jump; offset known to "
    text += f"± {last.offset_std_ns / 1e3:.1f} µs, drift {last.drift_ppm:+.1f} ± "
    return good("clock", f"{text}{last.drift_std_ppm:.1f} ppm")


def _check_attached_input(r: Recording) -> Finding:
    path, content = beginning(r.path)
    if content.input is None:
        return warning("input", f"no {r.manifest.source} is attached")
    try:
        u = read_input(path, content.input, r.manifest.samples)
    except DamageError as err:
        return unusable("input", str(err))
    run = control_run(r) or own_control_run(r)
    return check_input(r, u) if run is None else check_control(r, run, u)


def check_control(r: Recording, run: ControlRun | OwnControlRun, reference: Vector) -> Finding:
    """Check that reference and input of each decision agree with the attachment and the samples."""
    at = run.k - r.manifest.k_first
    if reference.size != r.manifest.samples or ((at < 0) | (at >= reference.size)).any():
        return unusable("input", f"the attached reference has {plural(reference.size, 'value')}")
    expected = reference[at]
    if isinstance(run, ControlRun):
        same_command = np.append(False, np.diff(run.reference_n) == 0)  # it set one value
        before = np.where(same_command, np.append(np.nan, run.r[:-1]), run.r)
        expected = np.where(run.reference_n > 0, before, expected)
    if (other := expected != run.r).any():
        k = run.k[other.argmax()]
        return unusable("input", f"the reference at k={k} is not the attached one")
    _, decisions, samples = np.intersect1d(run.k, r.samples["k"], return_indices=True)
    if samples.size < r.samples.size:
        return unusable("input", f"{plural(r.samples.size - samples.size, 'sample')} without a law")
    if (other := run.u[decisions] != r.samples["u_cmd_v"][samples]).any():
        k = r.samples["k"][samples[other.argmax()]]
        return unusable("input", f"the voltage at k={k} is not that of the law")
    if isinstance(run, OwnControlRun):
        return good("input", run.summary)
    return good("input", f"by the law in {plural(run.k.size, 'decision')}, {run.shares}")


def _check_configuration(r: Recording) -> Finding:
    """Check the requested voltages against the limits of the attached configuration."""
    _, content = beginning(r.path)
    text = content.attachments.get(CONFIG)
    if text is None:
        return warning("configuration", "no configuration is attached")
    try:
        limits = msgspec.json.decode(text, type=_RecordedConfig).limits
    except msgspec.DecodeError as err:
        return unusable("configuration", f"it cannot be read ({err})")
    u = r.samples["u_cmd_v"]
    low, high = limits.u_min_v - 0.5 * _CODE_V, limits.u_max_v + 0.5 * _CODE_V
    if u.size and not (low <= u.min() and u.max() <= high):
        fault = f"{u.min():.4g} to {u.max():.4g} V were requested, outside the limits "
        return unusable("configuration", f"{fault}{limits.u_min_v:g} to {limits.u_max_v:g} V")
    return good("configuration", "the requested voltages are in its limits")


def _check_attachments(r: Recording) -> Finding:
    """Check that no attachment is missing; `load` has compared the hashes."""
    _, content = beginning(r.path)
    if fault := attachment_fault(content, r.manifest):  # of a damaged file, which is loaded
        return unusable("attachments", fault)
    hashes, names = r.manifest.attachment_hashes, attachment_names(content, r.manifest)
    if missing := sorted({*hashes} - names):
        text = f"missing, although the manifest contains the hash: {join_names(missing)}"
        if r.recovered is not None and r.recovered.damage:
            return warning("attachments", f"{text}; {r.recovered.damage}")
        return unusable("attachments", text)
    if not names:
        return warning("attachments", "nothing is attached")
    if r.unhashed:
        text = f"the manifest, by armrig {r.manifest.armrig}, contains no hash of "
        return warning("attachments", f"{text}{join_names(r.unhashed)}: an exchange is not found")
    return good("attachments", f"each has the hash in the manifest: {join_names(sorted(names))}")


class _RecordedLimits(msgspec.Struct, frozen=True):
    u_min_v: float = 0.0
    u_max_v: float = U_MAX_V


class _RecordedConfig(msgspec.Struct, frozen=True):
    limits: _RecordedLimits = _RecordedLimits()


def _verdict(verification: Verification) -> str:
    failed = [check.about for check in verification.checks if check.level == "unusable"]
    if failed:
        return f"failed: {', '.join(failed)}"
    left = [check.about for check in verification.checks if check.level == "warning"]
    return "passed" + (f"; not checked: {', '.join(left)}" if left else "")


def rows(verification: Verification) -> Iterator[tuple[str, str]]:
    """Yield the rows of a table: the subject of a check and its result as text."""
    yield "verdict", _verdict(verification)
    yield "recording", str(verification.path)
    yield "sha256", verification.sha256
    for check in verification.checks:
        yield check.about, f"{RESULTS[check.level]}: {check.text}"
