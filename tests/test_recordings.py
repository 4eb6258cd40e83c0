"""Files of recordings: dialects of CSV, and formats as a reference library or their published description has them.

Written by a reference library: .npy, .npz (NumPy), .mat (SciPy, h5py), .c3d (ezc3d), ROS bags (rosbags), CK (spiceypy).
Written here from the published description: OpenSim storage, MVNX (MVN User Manual), BVH (Biovision), CSV.
"""

import io
import os
import re
import signal
import sys
import warnings

import h5py
import numpy as np
import pandas
import pytest
import scipy.io
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from nontwist import read_motion, rotation, twist
from nontwist.cli import app
from nontwist.recordings.formats import READERS, Content
from nontwist.recordings.formats.apart import read_apart
from nontwist.recordings.reading import read_rates
from recordings.makers import BVH, motive, qualisys, spice_kernels
from recordings.makers import R as MOVED
from refusals import refused, warned

N = 90
T = np.arange(N) / 50
R = Rotation.from_euler("ZYX", np.stack([0.3 + 2 * T, 0.5 * np.sin(3 * T), 0.4 - T], axis=1))
Q = R.as_quat()  # x, y, z, w
WXYZ = np.roll(Q, 1, axis=1)


def table(columns, sep=",", head="", decimal=".", digits="%.17g"):
    """A CSV of columns by header, the lines of `head` before it."""
    frame = pandas.DataFrame(columns)
    return io.StringIO(head + frame.to_csv(index=False, sep=sep, decimal=decimal, float_format=digits))


def quaternion(names="qw qx qy qz", values=WXYZ):
    return dict(zip(names.split(), values.T, strict=True))


def same(found, expected=R, tolerance=1e-12):
    """Assert that these are the attitudes, and that it says how orientation, time and direction were read."""
    if "notes" in getattr(found, "attrs", {}):
        said = [note.partition(": ")[0] for note in found.notes.split("; ")]
        assert {"orientation", "time"} <= set(said), found.notes
        assert {"direction", "checked", "inverted"} & set(said), found.notes
    assert (rotation(found).inv() * expected).magnitude().max() < tolerance


def matrix(motion):
    return {f"Mat[{i + 1}][{j + 1}]": motion.as_matrix()[:, i, j] for j in range(3) for i in range(3)}


MATRIX = matrix(R)
HEADERS = {
    "qw qx qy qz": quaternion(),
    "letters around": quaternion("Shimmer_Quat_W_CAL Shimmer_Quat_X_CAL Shimmer_Quat_Y_CAL Shimmer_Quat_Z_CAL"),
    "Quat_": quaternion("Quat_W Quat_X Quat_Y Quat_Z"),
    "Orientation/": quaternion("/imu/orientation/w /imu/orientation/x /imu/orientation/y /imu/orientation/z"),
    "x y z beside": {"x": T, "y": T, "z": T, **quaternion()},
    "real": quaternion("q_real q_i q_j q_k"),
    "r i j k": quaternion("qr qi qj qk"),
    "s x y z": quaternion("q_s q_x q_y q_z"),
    "Xsens": quaternion("Quat_q0 Quat_q1 Quat_q2 Quat_q3"),
    "EuRoC": quaternion("q_RS_w[] q_RS_x[] q_RS_y[] q_RS_z[]"),
    "Mat[1][1]": MATRIX,
}


@pytest.mark.parametrize("case", HEADERS)
def test_headers(case):
    found = read_motion(table({"time": T, **HEADERS[case]}))
    same(found)
    assert np.array_equal(found.time, T)


DIALECTS = {
    "semicolons, decimal commas": {"sep": ";", "decimal": ","},
    "tabs, decimal commas": {"sep": "\t", "decimal": ","},
    "commas, decimal commas in quotes": {"decimal": ","},
    "blanks": {"sep": " "},
    "MT Manager": {
        "sep": "\t",
        "head": "// General information:\n//  MT Manager version: 2022.2.0\n// Coordinate system: ENU\n",
    },
    "lines before": {"head": "sep=,\nDeviceTag:,DOT 1\nFirmwareVersion:,2.0.0\n\n"},
    "comments": {"head": "# a comment, with a comma\n# another\n"},
    "byte order mark": {"head": "\ufeff"},
}


@pytest.mark.parametrize("case", DIALECTS)
def test_dialects(case, tmp_path):
    text = table({"time": T, **quaternion()}, **DIALECTS[case]).getvalue()
    (tmp_path / "data.csv").write_text(text, encoding="utf-8")
    for source in (io.StringIO(text), tmp_path / "data.csv"):
        found = read_motion(source)
        same(found)
        assert found.time.values == pytest.approx(T, abs=1e-15)


def test_headers_in_a_comment_and_a_line_of_units():
    rows = table({"t": T, **quaternion()}).getvalue().split("\n", 1)[1]
    same(
        read_motion(io.StringIO("# made by hand\n#timestamp [ms], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n" + rows))
    )
    tum = (
        table({"t": T, "tx": T, "ty": T, "tz": T, **quaternion("qx qy qz qw", Q)}, sep=" ").getvalue().split("\n", 1)[1]
    )
    same(read_motion(io.StringIO("# timestamp tx ty tz qx qy qz qw\n" + tum)))
    found = read_motion(io.StringIO("Timestamp_CAL,W,X,Y,Z\nms,no_units,no_units,no_units,no_units\n" + rows))
    assert found.time.values == pytest.approx(T / 1000, abs=1e-18)


LETTERS = [a + b + c for a in "xyz" for b in "xyz" for c in "xyz" if a != b != c]


@pytest.mark.parametrize("letters", [*LETTERS, *(one.upper() for one in LETTERS)])
@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_every_order_of_angles(letters, unit):
    given = np.array([[0.2, 0.7, -0.4], [0.3, 0.8, 1.0], [-2.0, 0.5, 3.0]])
    columns = dict(zip("abc", (given if unit == "rad" else np.degrees(given)).T, strict=True))
    found = read_motion(table(columns), ["a", "b", "c"], euler=letters, angle_unit=unit)
    same(found, Rotation.from_euler(letters, given))
    about = "moving axes (intrinsic)" if letters.isupper() else "fixed axes (extrinsic)"
    assert f"Euler angles {letters} about {about}, {unit}: a, b, c" in found.notes


@pytest.mark.parametrize(
    "names",
    [
        ("Roll (deg)", "Pitch (deg)", "Yaw (deg)"),
        ("Euler_X [deg]", "Euler_Y [deg]", "Euler_Z [deg]"),
        ("roll_deg", "pitch_deg", "heading_deg"),
    ],
)
def test_angles_by_their_headers(names):
    yaw, pitch, roll = R.as_euler("ZYX", degrees=True).T
    columns = dict(zip(names, (roll, pitch, yaw), strict=True))
    same(read_motion(table({"time": T, **columns}), euler="ZYX"))
    assert np.array_equal(read_motion(table({"time": T, **columns}), euler="ZYX").time, T)
    wrong = read_motion(table({"time": T, **columns}), euler="zyx")
    assert (rotation(wrong).inv() * R).magnitude().max() > 0.1


def test_rotation_vectors():
    for unit, columns in (("rad", R.as_rotvec()), ("deg", np.degrees(R.as_rotvec()))):
        data = dict(zip(("rotvec_x", "rotvec_y", "rotvec_z"), columns.T, strict=True))
        same(read_motion(table(data), rotation_vector=True, angle_unit=unit))
    assert "rotation vector, rad" in read_motion(table(data), rotation_vector=True).notes


def test_numbered_quaternions_ask_for_the_scalar_unless_the_values_say_it():
    for names in ("q0 q1 q2 q3", "q1 q2 q3 q4", "quat_0 quat_1 quat_2 quat_3"):
        with refused("scalar-unknown"):
            read_motion(table(quaternion(names)))
        same(read_motion(table(quaternion(names)), scalar_first=True))
    tared = R[0].inv() * R
    for values, place in ((np.roll(tared.as_quat(), 1, axis=1), "first"), (tared.as_quat(), "last")):
        found = read_motion(table(quaternion("q0 q1 q2 q3", values)))
        same(found, tared)
        assert f"scalar {place}" in found.notes
    for values, place in ((WXYZ, "first"), (Q, "last")):
        found = read_motion(table({**quaternion("q0 q1 q2 q3", values), **gyroscope()}))
        same(found)
        assert f"scalar {place}" in found.notes
        assert "checked: agreement with the gyroscope 1.00" in found.notes


def gyroscope(motion=R, sign=1.0):
    """What a gyroscope measures, deg/s, between samples of a finer motion."""
    rate = np.degrees((motion[:-1].inv() * motion[1:]).as_rotvec()) * 50 * sign
    rate = np.vstack([rate, rate[-1:]])
    return {f"Gyr_{x}": rate[:, k] for k, x in enumerate("XYZ")}


def accelerometer(motion=R):
    up = motion.inv().apply([0, 0, 9.81])
    return {f"Acc_{x}": up[:, k] for k, x in enumerate("XYZ")}


@pytest.mark.parametrize("beside", [gyroscope, accelerometer])
def test_what_is_inverted_is_read_so_and_said(beside):
    same(right := read_motion(table({"time": T, **quaternion(), **beside()})))
    assert "checked: " in right.notes
    inverted = quaternion(values=np.roll(R.inv().as_quat(), 1, axis=1))
    for options, codes, expected in (
        ({}, ["reading-by-evidence"], R),
        ({"inverse": True}, [], R),
        ({"inverse": False}, ["options-contradicted"], R.inv()),
    ):
        with warned(*codes):
            same(read_motion(table({"time": T, **inverted, **beside()}), **options), expected)
    with warned("options-contradicted"):
        same(read_motion(table({"time": T, **quaternion(), **beside()}), inverse=True), R.inv())


def test_a_turn_about_the_vertical_tells_nothing_by_gravity():
    motion = Rotation.from_rotvec(np.outer(T, [0, 0, 2]))
    data = {**quaternion(values=np.roll(motion.inv().as_quat(), 1, axis=1)), **accelerometer(motion)}
    unconfirmed = "; direction: taken as sensor to earth, which nothing in the file confirms"
    assert read_motion(table(data)).notes.endswith(unconfirmed)
    assert "direction" not in read_motion(table(data), inverse=True).notes
    assert "direction" not in read_motion(table({**data, **gyroscope(motion)}), inverse=True).notes


def test_a_gyroscope_of_other_axes_overrules_no_labels():
    """By chance it agrees with the inverse to 0.72; by a constant rotation of its axes it agrees with the labels."""
    t = np.arange(100) / 50
    motion = Rotation.from_euler("ZYX", np.stack([0.3 + 2 * t, 0.5 * np.sin(3 * t), 0.4 - t], axis=1))
    rates = list(gyroscope(motion).values())
    mirrored = dict(zip(gyroscope(), (rates[1], rates[0], -rates[2]), strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read_motion(table({"time": t, **quaternion(values=motion.as_quat()[:, [3, 0, 1, 2]]), **mirrored}))
    same(found, motion)


def test_a_motion_that_comes_back_to_the_identity_loses_no_rows():
    """Its turning points and steps are like those beside them; identities far from all others stand for lost rows."""
    walk = 40 * abs(np.cumsum(np.random.default_rng(0).choice([-1, 1], N)))
    for degrees in (np.degrees(1 - np.cos(2 * np.pi * T)), walk.astype(float)):
        motion = Rotation.from_euler("z", degrees[:, None], degrees=True)
        for values in (quaternion(values=np.roll(motion.as_quat(), 1, axis=1)), matrix(motion)):
            same(read_motion(table({"time": T, **values})), motion)
    lost = WXYZ.copy()
    lost[[40, 41, 60]] = [1, 0, 0, 0]
    found = read_motion(table({"time": T, **quaternion(values=lost)}))
    assert np.flatnonzero(np.isnan(found.values).all(axis=1)).tolist() == [40, 41, 60]
    assert "missing: 3 rows, whose identities stand for lost ones, the first is line 42" in found.notes


DATES = pandas.to_datetime("2026-03-01T12:00:00.5") + pandas.to_timedelta(T, unit="s")
LATER = pandas.to_datetime("2026-12-31T23:59:59.5") + pandas.to_timedelta(T, unit="s")  # into the next year
TIMES = {
    "ISO": ("time", [d.isoformat() for d in DATES], {}),
    "ISO, UTC": ("Timestamp", [d.isoformat() + "Z" for d in DATES], {}),
    "slashes": ("DateTime", [d.strftime("%Y/%m/%d %H:%M:%S.%f") for d in DATES], {}),
    "day first": ("Datum", [d.strftime("%d.%m.%Y %H:%M:%S.%f") for d in DATES], {}),
    "day first, decimal comma": ("time", [d.strftime("%d.%m.%Y %H:%M:%S,%f") for d in DATES], {}),
    "US": ("Date", [d.strftime("%m/%d/%Y %H:%M:%S.%f") for d in LATER], {}),
    "US, AM and PM": ("Date", [d.strftime("%m/%d/%Y %I:%M:%S.%f %p") for d in LATER], {}),
    "day first, slashes": ("Date", [d.strftime("%d/%m/%Y %H:%M:%S,%f") for d in LATER], {}),
    "single digits": ("Date", [f"{d.month}/{d.day}/{d:%Y} {d.hour}:{d:%M:%S.%f}" for d in LATER], {}),
    "time of day, AM and PM": ("time", [d.strftime("%I:%M:%S.%f %p") for d in DATES - pandas.Timedelta(1, "s")], {}),
    "time of day": ("time", [d.strftime("%H:%M:%S.%f") for d in DATES], {}),
    "ms": ("time_ms", 1e3 * T, {}),
    "us": ("timestamp_us", np.round(1e6 * T).astype(int), {}),
    "ns in brackets": ("t [ns]", np.round(1e9 * T).astype(int), {}),
    "told": ("time", 1e3 * T, {"time_unit": "ms"}),
    "ticks": ("SampleTimeFine", np.round(1e4 * T).astype(int), {"time_unit": "1e-4"}),
    "epoch, ns": ("timestamp", 1772366400_000000000 + np.round(1e9 * T).astype(int), {}),
    "epoch, ms": ("unix_timestamp", 1772366400_000 + np.round(1e3 * T).astype(int), {}),
    "packets": ("PacketCounter", np.arange(N), {"rate": 50}),
    "packets of 16 bits": ("PacketCounter", (np.arange(N) + 65530) % 65536, {"rate": 50}),
    "ticks of 32 bits": (
        "SampleTimeFine",
        (np.round(1e6 * T).astype(int) + 2**32 - 10**6) % 2**32,
        {"time_unit": "us"},
    ),
    "no column": ("qq", np.zeros(N), {"rate": 50}),
    "named": ("when", T, {"time_column": "when"}),
}


@pytest.mark.parametrize("case", TIMES)
def test_times(case):
    name, values, options = TIMES[case]
    found = read_motion(table({name: values, **quaternion()}), **options)
    assert found.time.values - found.time.values[0] == pytest.approx(T, abs=1e-12)
    same(found)


def test_a_date_whose_order_is_unknown_is_refused_or_left_out():
    dates = [d.strftime("%d/%m/%Y %H:%M:%S.%f") for d in DATES]
    both = "both the first and the second number are above 12 in some row"
    mixed = ["13/01/2026 12:00:00", *["01/13/2026 12:00:01"] * (N - 1)]
    for given, why in ((dates, "neither is above 12"), (mixed, both)):
        columns = {"Date": given, **quaternion()}
        assert f"time: not used: the column 'Date' holds '{given[0]}'" in read_motion(table(columns)).notes
        with refused("day-or-month", name="Date", value=given[0], why=why):
            read_motion(table(columns), time_column="Date")


@pytest.mark.parametrize(
    ("case", "order"), [("US", "month/day"), ("US, AM and PM", "month/day"), ("day first, slashes", "day/month")]
)
def test_the_order_of_day_and_month_is_that_of_numbers_above_12(case, order):
    name, values, _ = TIMES[case]
    found = read_motion(table({name: values, **quaternion()}))
    assert found.attrs["start"] == LATER[0].timestamp()
    assert f"time: column 'Date', dates, {order}/year, as the numbers above 12 show" in found.notes


@pytest.mark.parametrize("wrong", ["13:00:00 PM", "0:00:00 AM", "12/31/2026 25:00:00", "2/31/2026 10:00:00"])
def test_times_that_do_not_exist_are_refused(wrong):
    with refused("not-a-time", name="Date", value=wrong):
        read_motion(table({"Date": [wrong] * N, **quaternion()}), time_column="Date")


def named(form, *names):
    return [form.format(name, axis) for name in names for axis in "xyz"]


ELSEWHERE = {  # what columns that are no orientation are taken for
    "a gyroscope": (gyroscope(), "gyroscope-alone", {"gyroscope": "Gyr_X, Gyr_Y, Gyr_Z"}),
    "markers": (
        [f"{name}{axis}" for name in ("Elbow ", "ARM_", "wrist.") for axis in "XYZ"],
        "markers",
        {"markers": "Elbow, ARM, wrist"},
    ),
    "no markers": (named("{}_{}", "pos", "vel", "force"), "no-orientation", {}),
    "sensors": (named("{}_{}", "Acc", "Mag", "a", "LinearAcceleration", "Elbow"), "no-orientation", {}),
    "three of four": (
        dict.fromkeys(("qw", "qx", "qy"), T),
        "three-of-four",
        {"three": "qw, qx, qy", "fourth": "qz"},
    ),
}


@pytest.mark.parametrize("case", ELSEWHERE)
def test_what_is_no_orientation_is_called_what_it_looks_like(case):
    columns, code, fields = ELSEWHERE[case]
    with refused(code, **fields):
        read_motion(table({"time": T, **dict.fromkeys(columns, T)}))


def test_messages_stay_short():
    with refused("no-orientation") as told:
        read_motion(io.StringIO("<html><body>" + "x" * 50_000 + "</body></html>\n"))
    assert len(str(told.value)) < 500
    with refused("no-orientation") as told:
        read_motion(table({f"a{k}z": T for k in range(500)}))
    assert told.value.fields["names"].endswith(" and 440 more")


def test_dates_keep_what_they_count_from():
    for case, start in (("ISO", 1772366400.5), ("epoch, ns", 1772366400), ("epoch, ms", 1772366400)):
        name, values, _ = TIMES[case]
        assert read_motion(table({name: values, **quaternion()})).attrs["start"] == start, case


UNKNOWN_TIMES = {
    "no unit": ({"time": np.arange(N) * 20}, "no-time-unit", {"name": "time", "step": 20}),
    "ticks": ({"SampleTimeFine": np.arange(N)}, "no-time-unit", {"name": "SampleTimeFine"}),
    # Movella DOT, an hour after it was switched on: no seconds since 1970
    "late ticks": ({"SampleTimeFine": 4_000_000_000 + 16_667 * np.arange(N)}, "no-time-unit", {"step": 16_667}),
    "late ticks, by another name": ({"timestamp": 4_000_000_000 + 16_667 * np.arange(N)}, "no-time-unit", {}),
    "a word": ({"time": ["noon"] * N}, "not-a-time", {"name": "time", "value": "noon"}),
    "two": ({"time": T, "t": 3 * T}, "several-times", {"names": "time, t"}),
}


@pytest.mark.parametrize("case", UNKNOWN_TIMES)
def test_a_time_that_is_not_understood_is_refused(case):
    columns, code, fields = UNKNOWN_TIMES[case]
    with refused(code, **fields):
        read_motion(table({**columns, **quaternion()}))


SAID = {
    "a name like time": ({"LocalTimeX": T}, "time: the column 'LocalTimeX' may hold times"),
    "units that disagree": ({"lag (s)": T, "delay (s)": 2 * T}, "the column 'lag (s)' may hold times"),
    "packets": ({"PacketCounter": np.arange(N)}, "the column 'PacketCounter' numbers the samples"),
    "empty": ({"SampleTimeFine": np.full(N, np.nan)}, "time: the column 'SampleTimeFine' is empty"),
    "none": ({}, "time: none"),
}


@pytest.mark.parametrize("case", SAID)
def test_columns_that_may_be_the_time_are_said_and_not_read(case):
    columns, note = SAID[case]
    found = read_motion(table({**columns, **quaternion()}))
    assert note in found.notes
    assert "time" not in found.coords


def test_packets_that_were_lost_leave_gaps():
    kept = np.delete(np.arange(N), [7, 8])
    found = read_motion(table({"PacketCounter": kept, **quaternion(values=WXYZ[kept])}), rate=50)
    assert found.time.values == pytest.approx(kept / 50)


def test_rounded_quaternions():
    short = np.round(WXYZ, 3)
    with_three = read_motion(table({"time": T, **quaternion(values=short)}), normalize=True)
    same(with_three, tolerance=2e-3)
    assert np.linalg.norm(with_three.values, axis=1) == pytest.approx(np.ones(N), abs=1e-15)
    assert "normalized: quaternions had lengths from 0.99" in with_three.notes
    raw = quaternion(values=np.round(WXYZ * 2**14).astype(int))
    with refused("scaled", rows="90 rows", place="line 2", what="quaternion"):
        read_motion(table({"time": T, **raw}))
    same(read_motion(table({"time": T, **raw}), normalize=True), tolerance=2e-4)
    rounded = {name: np.round(column, 1) for name, column in MATRIX.items()}
    same(read_motion(table({"time": T, **rounded}), normalize=True), tolerance=0.12)


def test_two_sensors_in_one_table():
    data = {"time": T, **quaternion("fore_qw fore_qx fore_qy fore_qz"), **quaternion("up_qw up_qx up_qy up_qz", Q)}
    with refused("bodies-in-columns", bodies="fore, up"):
        read_motion(table(data))
    same(read_motion(table(data), body="Fore"))
    with refused("no-body", body="leg", names="fore, up"):
        read_motion(table(data), body="leg")


@pytest.mark.parametrize(
    ("headers", "name"),
    [
        ("Upper_{}", "Upper"),
        ("Shoulder {}", "Shoulder"),
        ("r_{}", "r"),
        ("Upper.q{}", "Upper"),
        ("Upper_Quat_{}", "Upper"),
        ("Upperq{}", "Upper"),
    ],
)
def test_bodies_may_end_in_letters_of_rotations(headers, name):
    data = {"time": T, **quaternion("Fore_w Fore_x Fore_y Fore_z", Q)}
    data |= {headers.format(x): column for x, column in zip("wxyz", WXYZ.T, strict=True)}
    same(read_motion(table(data), body=name))


def test_a_matrix_of_a_body_may_end_in_letters_of_rotations():
    for headers, name in (("Upper_{}", "Upper"), ("Upper_r{}", "Upper"), ("Upper_m_{}", "Upper"), ("r{}", None)):
        data = {headers.format(re.sub(r"\D", "", key)): column for key, column in MATRIX.items()}
        same(read_motion(table({"time": T, **data}), body=name))


ABC = {"columns": ["a", "b", "c"]}
REFUSED = {
    "empty": ("", {}, "empty"),
    "headers alone": ("t,qw,qx,qy,qz\n", {}, ("too-few-samples", 0, 0)),
    "one row": ("t,qw,qx,qy,qz\n0,1,0,0,0\n", {}, ("too-few-samples", 1, 1)),
    "nothing finite": ("t,qw,qx,qy,qz\n0,nan,0,0,0\n1,,,,\n", {}, ("too-few-samples", 0, 2)),
    "angles": ("t,roll,pitch,yaw\n0,1,2,3\n1,1,2,3\n", {}, "angles"),
    "angles beside few rates": (
        "t,roll (deg),pitch (deg),yaw (deg),gx,gy,gz\n0,1,2,3,0,0,1\n1,1,2,3,0,0,1\n",
        {},
        "angles",
    ),
    "no unit": ("t,roll,pitch,yaw\n0,1,2,3\n", {"euler": "ZYX"}, "no-angle-unit"),
    "axes": ("t,roll,pitch,yaw\n0,1,2,3\n", {"euler": "ZZX"}, "euler"),
    "mixed axes": ("t,roll,pitch,yaw\n0,1,2,3\n", {"euler": "ZyX"}, "euler"),
    "which angles": ("t,a,b,c\n0,1,2,3\n", {"euler": "ZYX"}, "which-angles"),
    "three columns": ("a,b,c\n0,1,2\n", ABC, "three-columns"),
    "which vector": ("a,b,c\n0,1,2\n", {"rotation_vector": True}, "which-angles"),
    "fields": ("t,qw,qx,qy,qz\n0,1,0,0,0\n0,1,0,0,0,7,8\n", {}, "fields"),
    "more fields": ("qw,qx,qy,qz\n0,1,0,0,0\n", {}, "more-fields"),
    "unit of angles": ("a,b,c\n0,1,2\n", {"angle_unit": "grad", "euler": "ZYX", **ABC}, "type"),
    "two quaternions": ("qw,qx,qy,qz,qw,qx,qy,qz\n" + "1,0,0,0,1,0,0,0\n" * 2, {}, "several-orientations"),
    "words": ("hello world\nthis is no recording\n", {}, "no-orientation"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_by_a_code(case):
    text, options, code = REFUSED[case]
    code, *counts = (code,) if isinstance(code, str) else code
    with refused(code, **dict(zip(("left", "count"), counts, strict=False))):
        quietly(text, options)


def quietly(text, options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return twist(read_motion(io.StringIO(text), **options))


# formats


STO = "DataRate=50\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.1\nendheader\n"
MOT = "joint angles\nversion=1\nnRows=90\nnColumns=4\ninDegrees={}\n\nendheader\n"


def test_opensim_quaternions(tmp_path):
    rows = ["time\ttorso_imu\thumerus_imu"]
    for t, q in zip(T, WXYZ, strict=True):
        cell = ",".join(f"{x:.17g}" for x in q)
        rows.append(f"{t:.17g}\t1,0,0,0\t{cell}")
    (tmp_path / "a.sto").write_text(STO + "\n".join(rows) + "\n", encoding="utf-8")
    found = read_motion(tmp_path / "a.sto", body="humerus_imu")
    same(found)
    assert np.array_equal(found.time, T)
    with refused("several-bodies", names="torso_imu, humerus_imu"):
        read_motion(tmp_path / "a.sto")
    assert found.notes == (
        "orientation: quaternions of OpenSim, scalar first; body: humerus_imu; time: as the format defines, s; "
        "direction: body to space, as the format defines, which nothing in the file confirms"
    )
    (tmp_path / "b.sto").write_text("no header\n1\t2\n", encoding="utf-8")
    with refused("no-endheader"):
        read_motion(tmp_path / "b.sto")


@pytest.mark.parametrize("said", ["yes", "no"])
def test_opensim_angles_in_the_unit_of_the_header(said, tmp_path):
    angles = R.as_euler("ZXY", degrees=said == "yes")
    text = MOT.format(said) + "time\tarm_flex\tarm_add\tarm_rot\n"
    text += "".join("\t".join(f"{x:.17g}" for x in (t, *row)) + "\n" for t, row in zip(T, angles, strict=True))
    (tmp_path / "a.mot").write_text(text, encoding="utf-8")
    found = read_motion(tmp_path / "a.mot", ["arm_flex", "arm_add", "arm_rot"], euler="ZXY")
    same(found)
    assert np.array_equal(found.time, T)
    assert f"as inDegrees={said} says" in found.notes


MVNX = """<?xml version="1.0" encoding="UTF-8"?>
<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4"><mvn version="2020"/>
<subject label="S" frameRate="50" segmentCount="2">
<segments><segment label="Pelvis" id="1"><points><point label="p"/></points></segment>
<segment label="RightForeArm" id="2"/></segments>
<sensors><sensor label="RightForeArm"/></sensors>
<frames segmentCount="2" sensorCount="1">
<frame time="0" index="" type="npose"><orientation>1 0 0 0 1 0 0 0</orientation></frame>
{}</frames></subject></mvnx>
"""


def test_mvnx(tmp_path):
    frames = "".join(
        f'<frame time="{1000 * t:.0f}" index="{k}" type="normal"><orientation>1 0 0 0 '
        f"{' '.join(f'{x:.9f}' for x in q)}</orientation><position>0 0 0 0 0 0</position>"
        f"<sensorOrientation>{' '.join(f'{x:.9f}' for x in -q)}</sensorOrientation></frame>\n"
        for k, (t, q) in enumerate(zip(T, WXYZ, strict=True))
    )
    path = tmp_path / "a.mvnx"
    path.write_text(MVNX.format(frames), encoding="utf-8")
    for body in ("RightForeArm", "sensor RightForeArm"):
        found = read_motion(path, body=body)
        same(found, tolerance=1e-8)
        assert found.time.values == pytest.approx(T)
    with refused("several-bodies", names="Pelvis, RightForeArm, sensor RightForeArm"):
        read_motion(path)
    path.write_text(MVNX.format(frames)[:2000], encoding="utf-8")
    with refused("unreadable", what="MVNX file"):
        read_motion(path)


def test_bvh(tmp_path):
    hips, arm = R.as_euler("ZXY", degrees=True), R[::-1].as_euler("YXZ", degrees=True)
    rows = [" ".join(f"{x:.17g}" for x in (1, 2, 3, *a, *b, 0, 0, 0)) for a, b in zip(hips, arm, strict=True)]
    head = f"{BVH}Frames: {N}\nFrame Time: 0.02\n"
    path = tmp_path / "a.bvh"
    path.write_text(head + "\n".join(rows), encoding="utf-8")
    same(read_motion(path, body="Hips"))
    same(read_motion(path, body="Leg"))
    found = read_motion(path, body="Arm")
    same(found, R * R[::-1])
    assert found.time.values == pytest.approx(T)
    path.write_text(head + "\n".join([*rows[:3], "1 2 3"]), encoding="utf-8")
    assert path.read_text(encoding="utf-8").split("\n")[30] == "1 2 3"
    with refused("row-length", place="line 31", what="motion", count=3, width=12):
        read_motion(path, body="Arm")
    path.write_text("HIERARCHY\nROOT a\n{\nCHANNELS 3 Xrotation", encoding="utf-8")
    with refused("no-hierarchy"):
        read_motion(path)


def test_numpy_files(tmp_path):
    np.save(tmp_path / "q.npy", WXYZ)
    same(read_motion(tmp_path / "q.npy", scalar_first=True, rate=50))
    np.save(tmp_path / "m.npy", R.as_matrix())
    same(read_motion(tmp_path / "m.npy"))
    np.save(tmp_path / "tq.npy", np.column_stack([T, WXYZ]))
    found = read_motion(tmp_path / "tq.npy", scalar_first=True)
    same(found)
    assert np.array_equal(found.time, T)
    np.save(tmp_path / "s.npy", np.rec.fromarrays([T, *WXYZ.T], names="time,qw,qx,qy,qz"))
    same(read_motion(tmp_path / "s.npy"))
    np.save(tmp_path / "o.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with refused("unreadable", what="NPY file"):
        read_motion(tmp_path / "o.npy")
    np.savez(tmp_path / "two.npz", arm=Q, leg=Q, t=T)
    same(read_motion(tmp_path / "two.npz", body="leg", scalar_first=False))
    with refused("scalar-unknown", who="the array 'leg' does"):
        read_motion(tmp_path / "two.npz", body="leg")


def test_matlab_files(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"quat": WXYZ, "time": T[:, None]})
    found = read_motion(tmp_path / "a.mat", scalar_first=True)
    same(found)
    assert np.array_equal(found.time, T)
    scipy.io.savemat(
        tmp_path / "b.mat", {"imu": {"qw": WXYZ[:, 0], "qx": WXYZ[:, 1], "qy": WXYZ[:, 2], "qz": WXYZ[:, 3]}}
    )
    same(read_motion(tmp_path / "b.mat", rate=50))
    scipy.io.savemat(tmp_path / "c.mat", {"R": np.moveaxis(R.as_matrix(), 0, 2)})
    same(read_motion(tmp_path / "c.mat"))
    with h5py.File(tmp_path / "d.mat", "w", userblock_size=512) as file:
        file["quat"], file["time"] = WXYZ.T, T[None]
    with open(tmp_path / "d.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    same(read_motion(tmp_path / "d.mat", scalar_first=True))
    (tmp_path / "e.mat").write_bytes((tmp_path / "a.mat").read_bytes()[:300])
    with refused("unreadable", what="MAT file"):
        read_motion(tmp_path / "e.mat")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = WXYZ.T
    with h5py.File(tmp_path / "f.mat", "w", userblock_size=512) as file:
        layout = h5py.VirtualLayout(shape=(4, N), dtype=float)
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "secret", shape=(4, N))
        file.create_virtual_dataset("quat", layout)
    with open(tmp_path / "f.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    with refused("unreadable", what="MAT file"):
        read_motion(tmp_path / "f.mat", scalar_first=True)


def end_the_process(path):
    os.abort()


def test_a_library_that_ends_its_process_does_not_end_ours(tmp_path):
    with pytest.raises(RuntimeError, match=f"the process that reads it ended with -{signal.SIGABRT.value}"):
        read_apart(end_the_process, tmp_path / "x")


def test_c3d(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [50]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["m"]
    file["data"]["points"] = np.zeros((4, 1, N))
    poses = np.tile(np.eye(4)[:, :, None, None], (1, 1, 2, N))
    poses[:3, :3, 1] = np.moveaxis(R.as_matrix(), 0, 2)
    file.add_parameter("ROTATION", "LABELS", ["pelvis_4X4", "r_larm_4X4"])
    file["data"]["rotations"] = poses
    path = tmp_path / "a.c3d"
    file.write(str(path))
    found = read_motion(path, body="r_larm_4X4", normalize=True)
    same(found, tolerance=1e-6)  # C3D holds single precision
    assert found.time.values == pytest.approx(T)
    plain = ezc3d.c3d()
    plain["parameters"]["POINT"]["RATE"]["value"] = [50]
    plain["parameters"]["POINT"]["LABELS"]["value"] = ["m"]
    plain["data"]["points"] = np.zeros((4, 1, 3))
    plain.write(str(path))
    with refused("no-rotations"):
        read_motion(path)
    path.write_bytes(b"garbage\x00" * 100)
    with refused("unreadable", what="C3D file"):
        read_motion(path)


@pytest.mark.parametrize("version", [1, 2])
def test_ros_bags(version, tmp_path):
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    kinds = store.types
    path = tmp_path / ("a.bag" if version == 1 else "a")
    writer = rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=8)
    pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        add = {"typestore": store}
        one = writer.add_connection("/imu", "sensor_msgs/msg/Imu", **add)
        other = writer.add_connection("/pose", "geometry_msgs/msg/PoseStamped", **add)
        third = writer.add_connection("/inverted", "sensor_msgs/msg/Imu", **add)
        fourth = writer.add_connection("/odometry", "nav_msgs/msg/Odometry", **add)
        rates = np.radians(np.stack(list(gyroscope().values()), axis=1))
        for k, (t, q) in enumerate(zip(T, Q, strict=True)):
            nanoseconds = 1_700_000_000_000_000_000 + round(1e9 * t)
            stamp = kinds["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
            first = {"seq": k} if version == 1 else {}
            header = kinds["std_msgs/msg/Header"](**first, stamp=stamp, frame_id="map")
            turned = kinds["geometry_msgs/msg/Quaternion"](*q)
            zero = kinds["geometry_msgs/msg/Vector3"](0, 0, 0)
            nine = np.zeros(9)
            rate = kinds["geometry_msgs/msg/Vector3"](*rates[k])
            imu = kinds["sensor_msgs/msg/Imu"](header, turned, nine, rate, nine, zero, nine)
            back = kinds["geometry_msgs/msg/Quaternion"](*(q * [-1, -1, -1, 1]))
            inverted = kinds["sensor_msgs/msg/Imu"](header, back, nine, rate, nine, zero, nine)
            place = kinds["geometry_msgs/msg/Point"](0, 0, 0)
            pose = kinds["geometry_msgs/msg/PoseStamped"](header, kinds["geometry_msgs/msg/Pose"](place, turned))
            posed = kinds["geometry_msgs/msg/PoseWithCovariance"](pose.pose, np.zeros(36))
            moving = kinds["geometry_msgs/msg/TwistWithCovariance"](
                kinds["geometry_msgs/msg/Twist"](zero, rate), np.zeros(36)
            )
            odometry = kinds["nav_msgs/msg/Odometry"](header, "base", posed, moving)
            for connection, message in ((one, imu), (other, pose), (third, inverted), (fourth, odometry)):
                writer.write(connection, nanoseconds + 5, pack(message, connection.msgtype))
    for topic in ("/imu", "/pose", "/odometry"):
        found = read_motion(path, body=topic)
        same(found)
        assert found.time.values == pytest.approx(T, abs=3e-7)
        assert found.attrs["start"] == pytest.approx(1.7e9, abs=1e-6)
        assert ("checked: agreement with the gyroscope" in found.attrs["notes"]) == (topic != "/pose")
    with warned("reading-by-evidence"):
        same(read_motion(path, body="/inverted"))
    with refused("which-topic", names="/imu, /pose, /inverted, /odometry"):
        read_motion(path)
    (tmp_path / "b.bag").write_bytes(b"garbage\x00" * 100)
    with refused("unreadable", what="ROS bag"):
        read_motion(tmp_path / "b.bag")


def test_spice(tmp_path):
    pytest.importorskip("spiceypy")
    meta = tmp_path / "a.tm"
    for spinning in (True, False):
        spice_kernels(meta, MOVED, spinning)
        found = read_motion(meta, rate=50)
        same(found, MOVED[: len(found)], tolerance=2e-6)
    assert found.sizes["time"] >= len(MOVED) - 1
    assert found.time.values == pytest.approx(T[: len(found)], abs=1e-7)
    spice_kernels(meta, MOVED.inv())
    with warned("reading-by-evidence"):
        found = read_motion(meta, rate=50)
    same(found[:N], R[: len(found)], tolerance=2e-6)
    with refused("no-rate"):
        read_motion(meta)
    with refused("which-instrument", names="-9000"):
        read_motion(meta, rate=50, body="-1")
    meta.write_text("garbage", encoding="utf-8")
    with refused("unreadable"):
        read_motion(meta, rate=50)


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [(".c3d", "ezc3d", "c3d"), (".bag", "rosbags.highlevel", "ros"), (".tm", "spiceypy", "spice")],
)
def test_a_library_that_is_missing_is_named_with_its_extra(suffix, module, extra, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    path = tmp_path / f"a{suffix}"
    path.write_text("x", encoding="utf-8")
    result = CliRunner().invoke(app, ["twist", str(path), "--rate", "50", "--out", str(tmp_path / "o")])
    wanted = f"this format is read by {module}: pip install 'nontwist[{extra}]'\n"
    assert (result.exit_code, result.stderr) == (2, wanted)


@pytest.mark.parametrize("suffix", READERS)
def test_files_that_are_empty_or_damaged_are_refused_in_our_words(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    for content in (b"", b"\x00\x01garbage", b"HIERARCHY MOTION", bytes(range(256)) * 4):
        path.write_bytes(content)
        with pytest.raises((ValueError, OSError)) as caught:
            read_motion(path, rate=50)
        assert type(caught.value).__module__.split(".")[0] in ("builtins", "nontwist"), caught.value
        assert len(str(caught.value)) < 400


def test_a_reader_is_added_in_one_place(tmp_path, monkeypatch):
    monkeypatch.setitem(READERS, ".arm", lambda path, how: Content(bodies={"arm": Q}, time=T))
    (tmp_path / "a.arm").write_text("x", encoding="utf-8")
    same(read_motion(tmp_path / "a.arm"))


def test_ticks_of_a_unit_that_is_told():
    ticks = 4_000_000_000 + 16_667 * np.arange(N)
    found = read_motion(table({"SampleTimeFine": ticks, **quaternion()}), time_unit="us")
    assert np.allclose(found.time - found.time[0], np.arange(N) * 0.016667, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("Zeit (s)", 1.0),
        ("Zeit", 1.0),
        ("ms", 1e3),
        ("elapsed (s)", 1.0),
        ("TimeStartup [ns]", 1e9),
        ("motionTimestamp_sinceReboot(s)", 1.0),
        ("Shimmer_8A_Timestamp_Unix_CAL (ms)", 1e3),
    ],
)
def test_a_column_with_a_unit_of_time_is_the_time(header, scale):
    found = read_motion(table({header: T * scale, **quaternion()}))
    assert np.allclose(found.time, T, rtol=1e-12)


def test_a_time_that_is_understood_is_taken_beside_one_that_is_not():
    columns = {"epoc (ms)": 1_683_188_000_000 + 20 * np.arange(N), "timestamp (+0200)": "2023-05-04T10.11.12"}
    found = read_motion(table({**columns, **quaternion()}))
    assert np.allclose(found.time, T)
    assert "time: not used: the column 'timestamp (+0200)' holds '2023-05-04T10.11.12'" in found.attrs["notes"]
    assert "=" not in found.attrs["notes"]  # commands have other words for options
    found = read_motion(table({"time": "tick", **quaternion()}), rate=50)
    assert np.allclose(found.time, T)
    assert "time: not used: the column 'time' holds 'tick'" in found.attrs["notes"]


def test_roll_is_found_among_desired_rolls():
    euler = dict(zip(("Yaw", "Pitch", "Roll"), R.as_euler("ZYX").T, strict=True))
    other = {f"Des{name}": 0 * T for name in euler}
    same(read_motion(table({**other, **euler}), euler="ZYX", angle_unit="rad"))


def test_bodies_of_motive_are_found_by_the_names_above_the_headers():
    same(read_motion(io.StringIO(motive({"Fore arm": Q}, T))), tolerance=1e-9)
    two = {"Fore arm": Q, "Upper": R.inv().as_quat()}
    same(read_motion(io.StringIO(motive(two, T)), body="fore arm"), tolerance=1e-9)
    same(read_motion(io.StringIO(motive(two, T)), body="Upper"), R.inv(), 1e-9)
    with refused("bodies-in-columns", bodies="Fore arm, Upper"):
        read_motion(io.StringIO(motive(two, T)))


def test_bodies_of_qualisys_are_found_and_agree_with_its_angles():
    same(read_motion(io.StringIO(qualisys({"fore arm": R}, T))), tolerance=1e-9)
    two = {"fore arm": R, "upper": R.inv()}
    same(read_motion(io.StringIO(qualisys(two, T)), body="upper"), R.inv(), 1e-9)
    same(read_motion(io.StringIO(qualisys({"fore arm": R}, T)), euler="XYZ", angle_unit="deg"), tolerance=1e-9)
    with refused("bodies-in-columns", bodies="fore arm, upper"):
        read_motion(io.StringIO(qualisys(two, T)))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings(tmp_path, encoding):
    content = table(dict(zip(("Yaw (°)", "Pitch (°)", "Roll (°)"), R.as_euler("ZYX", degrees=True).T, strict=True)))
    (tmp_path / "angles.csv").write_bytes(content.getvalue().encode(encoding))
    same(read_motion(tmp_path / "angles.csv", euler="ZYX", rate=50))


def test_comments_between_rows_are_left_out_and_said(tmp_path):
    lines = table({"time": T, **quaternion()}).getvalue().splitlines()
    text = "\n".join([*lines[:30], "# paused, and resumed, twice, by hand, at noon, I think", *lines[30:], "// end"])
    (tmp_path / "paused.csv").write_text(text, encoding="utf-8")
    for source in (io.StringIO(text), tmp_path / "paused.csv"):
        found = read_motion(source)
        same(found)
        assert "left out: 2 lines of comments between the rows" in found.attrs["notes"]


def test_the_time_beside_a_quaternion_in_a_structure_is_found(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"data": {"time": T, "q": Q}, "note": "by hand"})
    found = read_motion(tmp_path / "a.mat", scalar_first=False)
    assert np.array_equal(found.time, T)


def test_options_for_columns_are_refused_where_there_are_attitudes(tmp_path):
    np.savez(tmp_path / "a.npz", time=T, q=Q)
    for option in ({"euler": "ZYX"}, {"rotation_vector": True}):
        name = next(iter(option))
        with refused("attitudes", name=name, names="q"):
            read_motion(tmp_path / "a.npz", **option)


def test_a_bvh_file_that_is_cut_short_is_said(tmp_path):
    head = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n}\nMOTION\n"
    for frames, said in ((3, False), (5, True)):
        (tmp_path / "a.bvh").write_text(f"{head}Frames: {frames}\nFrame Time: 0.1\n" + "1 2 3\n" * 3, encoding="utf-8")
        notes = read_motion(tmp_path / "a.bvh").attrs["notes"]
        assert ("the file states 5 frames and holds 3: cut short or badly written" in notes) == said


def test_a_unit_that_a_header_contradicts_is_refused():
    columns = {"t [ms]": [0, 10, 20], **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), [30.0] * 3)}
    found = read_motion(table(columns), euler="xyz", angle_unit="deg", time_unit="ms")
    assert found.time[-1] == pytest.approx(0.02)
    with refused("angle-unit-stated", three="roll_deg, pitch_deg, yaw_deg", stated="deg", unit="rad"):
        read_motion(table(columns), euler="xyz", angle_unit="rad")
    with refused("time-unit-stated", name="t [ms]", stated="ms", unit="s"):
        read_motion(table(columns), euler="xyz", time_unit="s")


# messages name the line of a file of text, as an editor numbers it

ROWS = [f"{t:.2f},{w:.17g},{x:.17g},{y:.17g},{z:.17g}" for t, (w, x, y, z) in zip(T, WXYZ, strict=True)]
DROPPED = {"rows": "1 row", "place": 0}
WRONG_LINES = {  # what is put at row 40 and after; code and fields, in which numbers count from the line of row 40
    "a word": (["0.80,--,0,0,1"], "not-a-number", {"what": "the column 'qw'", "value": "--", "place": 0}),
    "a time": (["now,1,0,0,0"], "not-a-number", {"what": "the column 'time'", "value": "now", "place": 0}),
    "too many fields": (["0.80,1,0,0,0,7"], "fields", {"place": 0}),
    "no number": (["0.80,,,,"], "missing-rows", DROPPED),
    "a time again": ([ROWS[39]], "duplicate-times", DROPPED),
    "order": ([f"0.01,{ROWS[40].partition(',')[2]}"], "unsorted-times", {"place": 0}),
    "a gap": ([f"1.40,{ROWS[40].partition(',')[2]}"], "gaps", {"gaps": "1 gap", "first": -1, "last": 0}),
    "half a turn": (["0.80,0.6,0.8,0,0", "0.82,0,0,0.6,0.8"], None, "half a turn from line {0} to line {1}: "),
    "no rotation": (["0.80,2,0,0,0"], "missing-rows", DROPPED),
}
ABOVE = {"": "", "comments": "# a\n# b, c, d\n\n", "a preamble": "Device;x\n\nRate: 50\n"}


@pytest.mark.parametrize("normalize", [False, True])
def test_a_damaged_row_is_missing_and_never_converted(normalize):
    text = "time,qw,qx,qy,qz\n" + "\n".join([*ROWS[:40], "0.80,1.3,0.2,0.4,0", *ROWS[41:]])
    found = read_motion(io.StringIO(text), normalize=normalize)
    assert "missing: 1 row, which are not valid quaternions, the first is line 42" in found.notes
    assert np.flatnonzero(np.isnan(found.values).any(axis=1)).tolist() == [40]
    others = np.delete(np.arange(N), 40)
    same(found[others], R[others])


def test_attitudes_of_many_lengths_are_not_normalized():
    text = "time,qw,qx,qy,qz\n" + "".join(f"{k},2,{k},0,0\n" for k in range(9))
    for normalize in (False, True):
        with refused("not-rotations", what="quaternions", low=2):
            read_motion(io.StringIO(text), normalize=normalize)


def told_of(action):
    """The error or the first warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            action()
        except ValueError as error:
            return error
    return caught[0].message


def agrees(told, code, fields):
    """Assert that this was told, with these among its fields."""
    assert told.code == code, told
    assert {name: told.fields[name] for name in fields} == fields


@pytest.mark.parametrize("between", ["", "\n", "# a, comment, of, 5, fields\n", "  \n// one\n"])
@pytest.mark.parametrize("above", ABOVE)
@pytest.mark.parametrize("case", WRONG_LINES)
def test_messages_name_the_line_of_a_file(case, above, between, tmp_path):
    wrong, code, fields = WRONG_LINES[case]
    rows = [*ROWS[:40], *wrong, *([] if case == "a gap" else ROWS[40 + len(wrong) :])]
    text = ABOVE[above] + "time,qw,qx,qy,qz\n" + "\n".join([*rows[:20], between + rows[20], *rows[21:]]) + "\n"
    lines = text.split("\n")
    at = lines.index(wrong[0]) + 1 if case != "a time again" else lines.index(ROWS[39]) + 2
    (tmp_path / "8.csv").write_text(text, encoding="utf-8")
    (tmp_path / "16.csv").write_text(text, encoding="utf-16")
    for source in (tmp_path / "8.csv", tmp_path / "16.csv", io.StringIO(text)):
        told = told_of(lambda source=source: twist(read_motion(source)))
        if code is None:
            assert fields.format(at, at + 1) in str(told)
        else:
            places = {name: one if isinstance(one, str) else f"line {at + one}" for name, one in fields.items()}
            agrees(told, code, places)


NOTED = "t,qw,qx,qy,qz,note\n0,1,0,0,0,x\n1,1,0,0,0,"
TABBED = "t\tqw\tqx\tqy\tqz\tnote\n0\t1\t0\t0\t0\tx\n"


def cell(value, place):
    return "not-a-number", {"what": "the column 'qw'", "value": value, "place": place}


@pytest.mark.parametrize(("text", "told"), [
    ("t;qw;qx;qy;qz\n0,00;1,0;0;0;0\n0,01;1,0;0;0;0\n0,02;one;0;0;0\n0,03;1,0;0;0;0\n", cell("one", "line 4")),
    ('t,qw,qx,qy,qz\n0.00,1.0,0,0,0\n0.01,"1,0",0,0,0\n0.02,1.0,0,0,0\n', cell("1,0", "line 3")),
    (NOTED + '"a\nb"\n2,1,0,0,0,x\n3,1,0,0,0,x,9\n', ("fields", {"place": "a line", "count": 6})),
    (NOTED + '"a, b"\n2,1,0,0,0,x\n3,1,0,0,0,x,9\n', ("fields", {"place": "line 5", "count": 6})),
    (TABBED + '1\t1\t0\t0\t0\t"a\nb"\n\t\t\t\t\t\n3\tone\t0\t0\t0\tx\n', cell("one", "row 3")),
    (TABBED + "\t\t\t\t\t\n2\tone\t0\t0\t0\tx\n", cell("one", "line 4")),
    ("# a comment\n// another\n", ("comments-only", {})),
])  # fmt: skip
def test_lines_are_those_of_an_editor(text, told, tmp_path):
    """Fields of several lines make rows that are not lines; fields that are all empty are rows."""
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    for source in (tmp_path / "a.csv", io.StringIO(text)):
        with refused(told[0], **told[1]):
            read_motion(source)


def test_lines_belong_to_the_samples(tmp_path):
    """Those of a selection keep theirs; arrays, and tables without lines, have rows, counted from 0."""
    text = "# a\n\ntime,qw,qx,qy,qz\n" + "\n".join(ROWS[:40]) + "\n\n" + "\n".join(ROWS[40:])
    motion = read_motion(io.StringIO(text))
    lines = text.split("\n")
    assert [lines[k - 1] for k in motion.line.values] == ROWS
    part = motion.sel(time=slice(0.5, 1.5))
    part.values[3] = np.nan
    np.save(tmp_path / "a.npy", np.where(np.arange(N)[:, None] == 5, np.nan, Q))
    for action, place in (
        (lambda: twist(part), f"line {lines.index(ROWS[28]) + 1}"),
        (lambda: twist(part.values, scalar_first=False), "row 3"),
        (lambda: twist(read_motion(tmp_path / "a.npy", scalar_first=False)), "row 5"),
    ):
        agrees(told_of(action), "missing-rows", {"place": place})


def test_a_left_handed_matrix_is_named_by_its_line():
    columns = {f"r{i + 1}{j + 1}": R.as_matrix()[:, i, j].copy() for i in range(3) for j in range(3)}
    for name in ("r13", "r23", "r33"):
        columns[name][7] *= -1
    motion = read_motion(table({"time": T, **columns}, head="# a\n"))
    assert str(told_of(lambda: twist(motion))) == "rotation in line 10 is left-handed: its determinant is -1"


def test_two_files_of_other_lines_are_named_by_rows():
    """Both have the same times: a row is missing in both, whichever has no number there."""
    one = read_motion(table({"time": T, **quaternion()}))
    values = np.where(np.arange(N)[:, None] == 5, np.nan, WXYZ)
    for head, place in (("", "line 7"), ("# a\n", "row 5")):
        other = read_motion(table({"time": T, **quaternion(values=values)}, head=head))
        told = told_of(lambda other=other: twist(one, relative_to=other))
        agrees(told, "missing-rows", {"rows": "1 row", "place": place})


@pytest.mark.parametrize(("wrong", "code", "fields"), [
    ("x", "not-a-number", {"what": "the column 'b'", "value": "x"}),
    ("0 0", "labels", {"count": 5, "labels": 4}),
])  # fmt: skip
def test_lines_of_opensim(wrong, code, fields, tmp_path):
    text = MOT.format("yes") + "time a b c\n\n0 1 2 3\n\n0.1 1 WRONG 3\n"
    at = next(k for k, line in enumerate(text.split("\n"), 1) if "WRONG" in line)
    path = tmp_path / "a.mot"
    path.write_text(text.replace("WRONG", wrong), encoding="utf-8")
    with refused(code, place=f"line {at}", **fields):
        read_motion(path, ["a", "b", "c"], euler="ZXY")
    path.write_text(text.replace("WRONG", "nan"), encoding="utf-8")
    found = read_motion(path, ["a", "b", "c"], euler="ZXY")
    assert found.line.values.tolist() == [at - 2, at]


def test_lines_of_angular_velocities():
    """`fit_inertia` names them likewise."""
    gyroscope = {f"g{x} (rad/s)": column.astype(object) for x, column in zip("xyz", Q[:, :3].T, strict=True)}
    gyroscope["gy (rad/s)"][9] = None
    source = table({"time": T, **gyroscope}, head="# a\n\n")
    at = next(k for k, line in enumerate(source.getvalue().split("\n"), 1) if ",," in line)
    agrees(read_rates(source).warnings[0], "missing-rates", {"rows": "1 row", "place": f"line {at}"})
    with refused("not-a-number", what="the column 'gy (rad/s)'", value="x", place=f"line {at}"):
        read_rates(io.StringIO(source.getvalue().replace(",,", ",x,")))


# times that a spreadsheet has rounded


def coarse(every, rate=100, seconds=20):
    """A steady turn about z by 1 rad/s with its times rounded to `every` s, as CSV, and its exact times."""
    t = np.arange(rate * seconds) / rate
    values = Rotation.from_rotvec(np.outer(t, [0, 0, 1])).as_quat()[:, [3, 0, 1, 2]]
    return table({"time": np.round(np.round(t / every) * every, 9), **quaternion(values=values)}), t


def rounded(rows, step, each, hertz):
    """The fields of a warning of rounded times, to three digits."""
    exact = {"rows": f"{rows} rows", "place": "line 3", "rate": f"rate={hertz}"}
    return exact | {"step": step, "each": each, "hertz": hertz, "half": step / 2}


def agrees_about(told, fields):
    assert told.code == "rounded-times"
    assert told.fields == {k: v if isinstance(v, str) else pytest.approx(v, rel=5e-4) for k, v in fields.items()}


@pytest.mark.parametrize(("every", "rate", "told"), [
    (0.1, 100, rounded(1799, 0.1, 10, 100)),
    (0.1, 60, rounded(999, 0.1, 6, 60)),
    (1.0, 50, rounded(979, 1, 50, 50)),
])  # fmt: skip
def test_rounded_times_are_named_with_their_remedy(every, rate, told):
    source, t = coarse(every, rate)
    agrees_about(told_of(lambda: twist(read_motion(source))), told)
    source.seek(0)
    motion = read_motion(source, rate=rate)
    assert np.array_equal(motion.time, t)
    average = (t.size - 1) / (np.round(np.round(t[-1] / every) * every, 9))
    assert (
        f"time: the column 'time', {average:.4g} samples a second on average, is ignored, as a rate is given; "
        f"time: {rate} samples a second; "
    ) in motion.attrs["notes"]
    result = twist(motion)
    assert result.attrs["notes"] == ""
    assert result.twist_angle[-1] == pytest.approx(t[-1], rel=1e-12)
    assert abs(result.twist_rate - 1).max() < 1e-9


def test_rounded_times_of_angular_velocities():
    """They are named likewise for `fit_inertia`, and the rate replaces them."""
    t = np.arange(400) / 100
    source = table({"time": t.round(1), **{f"g{x} (rad/s)": np.sin(t + k) for k, x in enumerate("xyz")}})
    agrees_about(read_rates(source).warnings[0], rounded(359, 0.1, 10, 100))
    source.seek(0)
    found = read_rates(source, rate=100)
    assert np.array_equal(found.time, t)
    assert found.warnings == ()


def test_duplicates_in_a_part_alone_are_not_rounded_times():
    """A logger that hung for half the recording; a file that is in there twice is no file to sort."""
    t = np.arange(2000) / 100
    values = quaternion(values=np.tile(WXYZ[:40], (50, 1)))
    hung = read_motion(table({"time": np.where(t < 10, t, 10.0), **values}))
    agrees(told_of(lambda: twist(hung)), "duplicate-times", {"rows": "999 rows", "place": "line 1003"})
    twice = read_motion(table({"time": np.tile(t[:1000], 2), **values}))
    with refused("clock-goes-back", back=9.99, place="line 1002"):
        twist(twice)


def test_a_rate_replaces_times_of_a_format_and_times_that_cannot_be_read(tmp_path):
    np.savez(tmp_path / "a.npz", q=Q, time=np.round(T, 1))
    assert np.allclose(read_motion(tmp_path / "a.npz", scalar_first=False, rate=50).time, T, rtol=1e-12)
    columns = {"time": T.astype(object), **quaternion()}
    columns["time"][3] = "x"
    found = read_motion(table(columns), rate=50)
    assert np.allclose(found.time, T, rtol=1e-12)
    assert "time: the column 'time' is ignored, as a rate is given; time: 50 samples" in found.attrs["notes"]
    with refused("rate-and-time", name="time"):
        read_motion(table(columns), rate=50, time_column="time")
