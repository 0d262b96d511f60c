"""A description of a rig is read, or refused in a sentence with what is allowed."""

from __future__ import annotations

import re
from contextlib import suppress
from math import exp, inf
from pathlib import Path

import pytest
from armrig_core.errors import FileError, InputError
from armrig_core.rig import description
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.description import Description, read_description
from armrig_core.rig.firmware_image import IMAGES
from hypothesis import given, settings
from hypothesis import strategies as st

RIGS = Path(description.__file__).parents[1] / "rigs"
HEATER = (RIGS / "heater.toml").read_text()
OUTPUTS = {
    "arm": {"theta_1": "rad", "alpha": "rad"},
    "chassis": {"theta_1": "rad"},
    "heater": {"T1": "degC", "T2": "degC"},
    "heatshield": {"T": "degC"},
    "optoshield": {"light": "%"},
    "rc": {"y": "V"},
    "tclab": {"T1": "degC", "T2": "degC"},
}
POINTS = "points = [[100, 50.0], [200, 40.0], [400, 0.0]]"


def test_each_shipped_description_is_read() -> None:
    read = {path.stem: read_description(path) for path in RIGS.glob("*.toml")}

    units = {name: {o: y.unit for o, y in d.outputs.items()} for name, d in read.items()}
    assert units == OUTPUTS
    assert all(d.rig.name == name and d.model for name, d in read.items())
    limited = {n for n, d in read.items() if any(y.limited for y in d.outputs.values())}
    assert limited == {"heater", "heatshield", "tclab"}
    assert {n for n, d in read.items() if d.rig.image != "uno"} == set(IMAGES) - {"uno"}
    assert all(d.rig.image in ("uno", name) for name, d in read.items())


def test_the_arm_has_the_default_calibration() -> None:
    theta_1, alpha = read_description(RIGS / "arm.toml").outputs.values()
    default = Calibration()

    for output, meter in ((theta_1, default.theta_1), (alpha, default.alpha)):
        assert (output.zero_counts, output.per_count) == (meter.zero_counts, meter.rad_per_count)
        assert output.turning is meter.wraps


def test_a_reading_in_counts_has_a_value() -> None:
    T1 = Description.of(HEATER.encode()).outputs["T1"]

    assert (T1.low, T1.high, T1.samples, T1.blind_s) == (-inf, 70.0, 2, 10.0)
    assert T1.value(6553.6) == 0
    assert T1.value(16384) == pytest.approx(74.71, abs=0.01)


@pytest.mark.parametrize(
    ("counts", "value"), [(100, 50), (150, 45), (200, 40), (300, 20), (500, -20), (0, 60)]
)
def test_points_are_joined_by_lines_that_continue_at_the_ends(counts: float, value: float) -> None:
    text = HEATER.replace("zero_counts = 6553.6\nper_count = 0.0076", POINTS, 1)
    T1 = Description.of(text.encode()).outputs["T1"].conversion

    assert T1.value(counts) == value
    assert T1.counts(value) == counts


def test_the_table_of_the_thermistor_follows_its_formula() -> None:
    T = read_description(RIGS / "heatshield.toml").outputs["T"]
    for degC in range(0, 101):
        ratio = exp(3950 * (1 / (degC + 273.15) - 1 / 298.15))  # of the resistors
        assert T.value(64 * 1023 * ratio / (1 + ratio)) == pytest.approx(degC, abs=0.1)


@pytest.mark.parametrize(
    ("points", "error"),
    [
        ("[[1, 2]]", "points: give at least two pairs [counts, value] of finite numbers"),
        ("[[1, 2], [3, inf]]", "points: give at least two pairs"),
        ("[[0, -1.7e308], [65535, 1.7e308]]", "points: give at least two pairs"),
        ("[[1, 2], [3]]", "points[1] = None: expected `array` of length 2, got 1"),
        ("[[1, 2], [1, 3]]", "points: 1 after 1: the counts must increase"),
        ("[[1, 2], [2, 3], [3, 2.5]]", "points: 3 at 2 counts, and then 2.5: the values must"),
        ("[[1, 2], [2, 2]]", "points: 2 at 1 counts, and then 2: the values must increase, or"),
        ("[[1, 2], [2, 3]]\nper_count = 1.0", "points: give no per_count, zero_counts or turning"),
        ("[]", "per_count = 0.0 must be finite and not 0; without it, give points"),
        ("[[1, 2], [65537, 3]]", "points: 65537 counts; the converter reads 0 to 65535 counts"),
        ("[[-1, 2], [65536, 3]]", "points: -1 counts; the converter reads 0 to 65535 counts"),
    ],
)
def test_points_that_are_no_conversion_are_refused(points: str, error: str) -> None:
    text = HEATER.replace("zero_counts = 6553.6\nper_count = 0.0076", f"points = {points}", 1)

    with pytest.raises(InputError, match=re.escape(error)):
        Description.of(text.encode())


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("[input]", "[inputs]", "[inputs]: no such table; allowed are [rig], [input], [outputs]"),
        ('[rig]\nname = "heater"\n', "[input]\n", "not a TOML file: Cannot declare ('input',)"),
        ('"power"', '"details"', "input name = 'details': a name has 1 to 32 letters"),
        ("title =", "label =", "rig: label = 'Heater with two thermometers': no such key; allowed"),
        ('"heater"', '"the heater"', "name = 'the heater': a name has 1 to 32 letters a-z, A-Z"),
        ("Heater with", "\\u001b[2J", "title = '\\x1b[2J two thermometers': at most 80 printable"),
        ("[input]", '[rig.x]\n[input]', "rig: x = {}: no such key; allowed are name, title, image"),
        ("title", 'image = "mega"\ntitle', "image = 'mega': allowed are uno, tclab"),
        ("per_volt = 20.0", "u_max_v = 5.1", "input: u_max_v = 5.1: expected `float` <= 5.0"),
        ("per_volt = 20.0", "per_volt = 0", "input: per_volt = 0.0 must be finite and not 0"),
        ("outputs.T2", "outputs.T1", "not a TOML file: Cannot declare ('outputs', 'T1') twice"),
        ("outputs.T2", "outputs.power", "power: names two signals; give each signal a name of its"),
        ("outputs.T2", "outputs.k", "outputs = 'k': a name has 1 to 32 letters"),
        ("[model]", '[outputs.T3]\nunit = "K"\nper_count = 1.0\n[model]', "1 to 2 tables are"),
        ("blind_s", 'rate = "T2"\nblind_s', "T2: names two signals"),
        ('"degC"', '"$m$"', "outputs.T1: unit = '$m$': at most 80 printable"),
        ("outputs.T1", "outputs.valid_T2", "valid_T2: a column of recordings has this name"),
        ("outputs.T1", "outputs.T2_counts", "T2_counts: a column of recordings has this name"),
        ("outputs.T1", "outputs.present", "outputs = 'present': a name has"),
        ('"degC"', '"\\u0007"', "outputs.T1: unit = '\\x07': at most 80 printable characters"),
        ("per_count = 0.0076", "per_count = nan", "outputs.T1: per_count = nan must be finite"),
        ("per_count = 0.0076", "per_count = 1e300", "is read; ±1e+15 is allowed"),
        ("zero_counts = 6553.6", "zero_counts = 1e9", "zero_counts = 1000000000.0 must be within"),
        ("high = 70.0", "high = 70.0\nlow = 71.0", "low = 71.0 must be below high = 70.0"),
        ("high = 70.0", "turning = true", "turning = true needs unit = 'rad', not 'degC'"),
        ("high = 70.0", "turns = 2.0", "outputs.T1: turns = 2 needs turning = true; give low and"),
        ("high = 70.0", "turns = 0.005", "turns = 0.005 must be a whole number of hundredths"),
        ("high = 70.0", "turns = 700.0", "outputs.T1: turns = 700.0: expected `float` <= 655"),
        ("high = 70.0", "high = nan", "low = -inf must be below high = nan"),
        ("high = 70.0", "high = 481.0", "high = 481: no reading is above this limit; the sensor"),
        ("high = 70.0", "low = -76.0", "low = -76: no reading is below this limit; the sensor"),
        ("high = 70.0", "high = 448.0\nrail_is_outside = false", "no reading is above this limit"),
        ("high = 70.0", 'valid_rail = "top"', "outputs.T1: valid_rail = 'top': allowed"),
        ("offset = [23.0, 23.0]", "offset = [23.0, -80.0]", "the rig reads -80 degC at rest; the"),
        ("offset = [23.0, 23.0]", "offset = [23.0, -49.7]", "set valid_rail = 'low' if the sensor"),
        ('"degC"', '"rad"\nturning = true\nvalid_rail = "low"', "reads an end in its dead band"),
        ("high = 70.0", "low = 900.0", "low = 900, high = inf: every reading breaks a limit"),
        ("high = 70.0", "high = 20.0", "outputs.T1: the rig reads 23 degC at rest, outside -inf"),
        ("blind_s = 10.0", "blind_s = 0", "outputs.T1: blind_s = 0: expected `float` > 0"),
        ("blind_s = 10.0", "samples = 0", "outputs.T1: samples = 0: expected `int` >= 1"),
        ("A = [[-0.0058, 0.0011], ", "A = [[-0.0058], ", "A has 2 rows of [1, 2] numbers; with A"),
        ("B = [[0.010], [0.0]]", "B = [[0.010]]", "B has 1 row of [1] numbers; with A it must be"),
        ("C = [[1.0, 0.0], [0.0, 1.0]]", "C = [[1.0, 0.0]]", "model.C has 1 row; the rig has 2"),
        ("B = [[0.010]", "B = [[inf]", "model: B has a number that is not finite"),
        ("A = [[-0.0058", "A = [[+0.0058", "the rig is unstable; correct A, or set unstable"),
        ("offset = [23.0", "offset = [nan", "model.offset and model.noise must be finite"),
        ("noise = [0.05", "noise = [-0.05", "and noise not below 0"),
        ("delay_s = 15.0", "delay_s = -1", "model: delay_s = -1: expected `float` >= 0"),
        ("delay_s = 15.0", 'kind = "arm"', "A and kind is given: give A, B and C, or file"),
        ("delay_s = 15.0", "#" * 65536, "more than the 65536 B allowed"),
    ],
)  # fmt: skip
def test_a_bad_description_is_refused_with_what_is_allowed(
    old: str, new: str, error: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(HEATER.replace(old, new, 1))

    with pytest.raises(FileError, match=rf"^{re.escape(str(path))}: .*{re.escape(error)}"):
        read_description(path)


@pytest.mark.parametrize(
    ("keys", "sides"),
    [
        ("high = 440", ("", "above")),
        ("high = 470", ("", "above")),
        ("high = 70", ("", "")),
        ("high = 900\nrail_is_outside = true", ("", "above")),
        ("high = 440\nrail_is_outside = false", ("", "")),
        ("low = -40\nhigh = 70", ("below", "")),
        ("high = 495\nzero_counts = 65536\nper_count = -0.0076", ("above", "")),
    ],
)
def test_an_end_of_the_range_near_a_limit_is_outside_this_limit(
    keys: str, sides: tuple[str, str]
) -> None:
    """A reading of 0 counts, then a reading of full scale; T1 is -50 to 448 degC."""
    text = '[rig]\nname = "oven"\n[outputs.T1]\nunit = "degC"\n' + keys
    if "per_count" not in keys:
        text += "\nzero_counts = 6553.6\nper_count = 0.0076"
    output = Description.of(text.encode()).outputs["T1"]

    assert output.sides_of_rails == sides


def test_a_file_with_equations_must_be_python_and_is_part_of_the_hash(tmp_path: Path) -> None:
    path, equations = tmp_path / "rig.toml", tmp_path / "rig.py"
    path.write_text(
        '[rig]\nname = "r"\n[outputs.y]\nunit = "V"\nper_count = 1.0\n[model]\nfile = "rig.py"\n'
    )
    equations.write_text("model = 1\n")
    first = dict(read_description(path).rows())["sha256"]
    equations.write_text("model = 2\n")
    assert dict(read_description(path).rows())["sha256"] != first

    equations.write_text("model = (\n")
    with pytest.raises(FileError, match=r"rig\.py': no Python: '\(' was never closed"):
        read_description(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"rig\.toml: No such file"):
        read_description(tmp_path / "rig.toml")


WORDS = re.findall(r"\[\[?|\]|[\w.-]+|\n|=|\"|,", HEATER)
PIECES = [*WORDS, "nan", "-inf", "1e999", "{", "}", "true", "'''", "\\", "\x1b", "é", "#", "__"]


@given(
    st.lists(st.integers(0, len(WORDS) - 1), min_size=1, max_size=6),
    st.lists(st.sampled_from(PIECES) | st.text(max_size=8), min_size=1, max_size=6),
    st.binary(max_size=4),
)
@settings(max_examples=500, deadline=None)
def test_a_hostile_description_raises_one_of_two_errors(
    places: list[int], pieces: list[str], noise: bytes
) -> None:
    words = list(WORDS)
    for place, piece in zip(places, pieces, strict=False):
        words[place] = piece

    text = " ".join(words).encode("utf-8", "surrogatepass") + noise
    with suppress(FileError, InputError):
        Description.of(text)
