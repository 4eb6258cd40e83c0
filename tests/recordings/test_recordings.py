"""What is said of recordings: readings that are decided by what is beside, times, bodies, refusals, and their lines.

Files of every format and maker with known attitudes are in `recordings`.
"""

import gzip
import io
import re
import signal
import sys
import warnings
from functools import partial
from importlib import import_module

import h5py
import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

from conftest import ended
from nontwist import read_motion, rotation, twist
from nontwist.recordings import headers
from nontwist.recordings.conventions import evidence_of
from nontwist.recordings.formats import READERS, libraries
from nontwist.recordings.reading import read_rates
from nontwist.recordings.table import Table
from nontwist.recordings.times import BITS, counted_on
from recordings import makers
from recordings.makers import GYR, N, R, T, bvh, made, matrix, mvnx, quat, text, vector
from recordings.test_truth import require_motion
from refusals import refused, warned

Q = R.as_quat()  # x, y, z, w
WXYZ = np.roll(Q, 1, axis=1)


def table(columns, sep=",", head="", decimal=".", digits="%.17g"):
    """A CSV of columns by header, the lines of `head` before it."""
    frame = pandas.DataFrame(columns)
    return io.StringIO(head + frame.to_csv(index=False, sep=sep, decimal=decimal, float_format=digits))


def read(content, *columns, **how):
    """What is read of text, or of columns by header."""
    return read_motion(io.StringIO(content) if isinstance(content, str) else table(content), *columns, **how)


def quaternion(names="qw qx qy qz", values=WXYZ):
    return dict(zip(names.split(), values.T, strict=True))


def same(found, expected=R, tolerance=1e-12):
    assert (rotation(found).inv() * expected).magnitude().max() < tolerance


def gyroscope(motion=R):
    """What a gyroscope measures, deg/s, between samples of a finer motion."""
    rate = np.degrees((motion[:-1].inv() * motion[1:]).as_rotvec()) * 50
    return dict(zip(("Gyr_X", "Gyr_Y", "Gyr_Z"), np.vstack([rate, rate[-1:]]).T, strict=True))


def accelerometer(motion=R):
    return dict(zip(("Acc_X", "Acc_Y", "Acc_Z"), motion.inv().apply([0, 0, 9.81]).T, strict=True))


def backwards(motion=R):
    """The quaternions of the inverse."""
    return quaternion(values=np.roll(motion.inv().as_quat(), 1, axis=1))


@pytest.mark.parametrize("beside", [gyroscope, accelerometer])
def test_inverted_reading_is_said(beside):
    right, wrong = ({"time": T, **one, **beside()} for one in (quaternion(), backwards()))
    same(found := read(right))
    assert "checked: " in found.notes
    for columns, options, codes, expected in (
        (wrong, {}, ["reading-by-evidence"], R),
        (wrong, {"inverse": True}, [], R),
        (wrong, {"inverse": False}, ["options-contradicted"], R.inv()),
        (right, {"inverse": True}, ["options-contradicted"], R.inv()),
    ):
        with warned(*codes):
            same(read(columns, **options), expected)


def test_rows_out_of_order():
    order = np.random.default_rng(0).permutation(N)
    columns = {"time": T, **backwards(), **gyroscope()}
    with warned("reading-by-evidence"):
        same(read({name: values[order] for name, values in columns.items()}), R[order])


STEPS = np.array([[-1e-4], [0], [1e-4]])


@pytest.mark.parametrize("yaw", [0.65, 0.4])
@pytest.mark.parametrize("header", ["{} (deg)", "{}"])
def test_better_excluded_reading_is_said(header, yaw):
    """Of a body that turns mostly about y; XYZ agrees to 0.89, and to 0.91 with the columns in another order, or to
    0.94 and 0.95. No other is taken instead of what was stated.
    """
    early, angles, late = (np.stack([yaw * t, 0.6 * np.sin(6 * t) - 0.3, 0.1 * np.cos(6 * t)]) for t in T + STEPS)
    early, R, late = (Rotation.from_euler("ZYX", one.T) for one in (early, angles, late))
    names = [header.format(name) for name in ("yaw", "pitch", "roll")]
    rates = vector("g{} (deg/s)", np.degrees((early.inv() * late).as_rotvec()) / 2e-4)
    data = {"time": T, **dict(zip(names, np.degrees(angles), strict=True)), **rates}
    same(read(data, euler="ZYX", angle_unit="deg"), R)
    if "deg" not in header:
        with refused("options-contradicted"):
            read(data, euler="XYZ")
        return
    with warned("options-contradicted"):
        same(read(data, euler="XYZ"), Rotation.from_euler("XYZ", angles[::-1].T))


def test_slightly_better_order_is_said():
    """Of small angles the wrong order agrees to 0.994, beside 1.0000."""
    names = ("yaw (deg)", "pitch (deg)", "roll (deg)")
    early, angles, late = (np.stack([t, 0.12 * np.sin(6 * t), 0.12 * np.cos(5 * t)]) for t in T + STEPS)
    early, late = (Rotation.from_euler("ZYX", one.T) for one in (early, late))
    rates = vector("g{} (deg/s)", np.degrees((early.inv() * late).as_rotvec()) / 2e-4)
    data = {"time": T, **dict(zip(names, np.degrees(angles), strict=True)), **rates}
    same(read(data, euler="ZYX"), Rotation.from_euler("ZYX", angles.T))
    with warned("options-contradicted") as told:
        read(data, euler="ZXY")
    assert 0.99 < told[0].fields["mine"] < 0.999 < told[0].fields["best"]


OTHER = Rotation.from_rotvec(np.outer(np.sin(9 * T), [0.3, -0.2, 0.1]))
SLOW = Rotation.from_rotvec(np.outer(T / T[-1], [0.0, 0, 0.5]))


@pytest.mark.parametrize(("motion", "measured", "factor", "codes"), [
    (R, R, 1.08, []), (R, R, 1.15, ["time-contradicted"]), (R, OTHER, 1, ["no-reading-fits"]),
    (SLOW, OTHER, 1, ["no-reading-fits"]), (SLOW**0.5, OTHER, 1, []),
])  # fmt: skip
def test_contradicting_gyroscope(motion, measured, factor, codes):
    """Or with another unit of times; a body that turns by less than 0.3 rad contradicts nothing."""
    rates = {f"{name} (deg/s)": factor * one for name, one in gyroscope(measured).items()}
    with warned(*codes):
        same(read({"time (s)": T, **backwards(motion.inv()), **rates}), motion)


def test_turns_lost_between_attitudes():
    """At 50 Hz, of 45 turns a second; they look like five backwards, which no inverse and no other time explains."""
    early, motion, late = (Rotation.from_euler("YZ", np.stack([np.sin(t), 90 * np.pi * t], axis=1)) for t in T + STEPS)
    rates = vector("g{} (rad/s)", (early.inv() * late).as_rotvec() / 2e-4)
    with warned("turns-lost") as told:
        same(read({"time (s)": T, **backwards(motion.inv()), **rates}), motion)
    assert told[0].fields["steps"] == "59 steps"
    assert told[0].fields["most"] == pytest.approx(0.9, abs=1e-3)
    with warned("time-contradicted"):
        same(read({"time (s)": T, **backwards(R.inv()), **vector("g{} (rad/s)", np.degrees(GYR))}))


ROUND = np.stack([(4 * T + 3) % (2 * np.pi) - np.pi, 0.3 * np.sin(T), 0.2 * T])  # rad, beyond half a turn
ONCE = Rotation.from_rotvec(np.outer(4 * T + 1, [0.6, 0, 0.8]))


@pytest.mark.parametrize(("values", "options", "codes"), [
    (ROUND, {"euler": "ZYX", "angle_unit": "deg"}, ["short-angles"]),
    (ROUND, {"euler": "ZYX", "angle_unit": "rad"}, []),
    (ROUND / 2, {"euler": "ZYX", "angle_unit": "deg"}, []),
    (ONCE.as_quat(canonical=True).T[:3], {"rotation_vector": True}, ["vector-of-quaternion"]),
    (ONCE.as_rotvec().T, {"rotation_vector": True}, []),
])  # fmt: skip
def test_leaps_at_half_a_turn(values, options, codes):
    with warned(*codes):
        read({"t": T, **dict(zip("xyz" if "euler" not in options else ("yaw", "pitch", "roll"), values, strict=True))},
            columns=None if "euler" in options else list("xyz"), **options)  # fmt: skip


def test_units_of_single_angles():
    for unit, code in ((" (rad)", "angle-units"), ("", "angle-unit-stated")):
        with refused(code):
            read({"t": T, "yaw (deg)": T, f"pitch{unit}": T, f"roll{unit}": T}, euler="ZYX", angle_unit="rad")


def test_twenty_blocks_of_many_rows():
    given = evidence_of(Table(), 60_000, None)
    assert np.array_equal(given.rows, (np.linspace(0, 59_000, 20).astype(int)[:, None] + np.arange(1000)).ravel())


def test_vertical_turn_and_gravity():
    motion = Rotation.from_rotvec(np.outer(T, [0, 0, 2]))
    data = {**backwards(motion), **accelerometer(motion)}
    unconfirmed = "; direction: taken as sensor to earth, which nothing in the file confirms"
    assert read(data).notes.endswith(unconfirmed)
    for columns in (data, {**data, **gyroscope(motion)}):
        assert "direction" not in read(columns, inverse=True).notes


WAVY = np.stack([np.sin(T**2), np.sin(2 * T**2) / 3, T**2], axis=1)  # rad, from rest


@pytest.mark.parametrize(("decimals", "slow", "kept", "lost"), [
    (6, 1, np.delete(np.arange(N), [7, 20, 41, 42]), [7, 20, 41, 42]), (6, 1, np.arange(0, N, 2).repeat(2), None),
    (1, 0.01, np.arange(N), []), (3, 0.3, np.arange(N), []), (6, 1, np.r_[:20, np.full(3, 20), 20 : N - 3], []),
])  # fmt: skip
@pytest.mark.parametrize(
    "of",
    [
        lambda angles: dict(zip(("yaw", "pitch", "roll"), angles, strict=True)),
        lambda angles: quaternion(values=np.roll(Rotation.from_euler("ZYX", angles.T).as_quat(), 1, axis=1).round(6)),
    ],
)
def test_held_rows_are_missing(decimals, slow, kept, lost, of):
    """Not where it rests, or where rounding repeats them."""
    kept = np.maximum.accumulate(np.where(np.isin(np.arange(N), kept), np.arange(N), 0)) if lost else kept
    columns = of(np.round(slow * WAVY[kept].T, decimals))
    found = read(columns, euler=None if "qw" in columns else "ZYX", angle_unit=None if "qw" in columns else "rad")
    assert (missing(found) == lost) if lost is not None else (missing(found)[-20:] == list(range(N - 41, N - 1, 2)))


def missing(found):
    return np.flatnonzero(np.isnan(found.values).all(axis=1)).tolist()


DATES = pandas.to_datetime("2026-03-01T12:00:00.5") + pandas.to_timedelta(T, unit="s")
LATER = pandas.to_datetime("2026-12-31T23:59:59.5") + pandas.to_timedelta(T, unit="s")  # into the next year


ABOVE_12 = "year, as the numbers above 12 show"


def of_dates(form, dates=LATER):
    return [d.strftime(form.format(d)) for d in dates]


@pytest.mark.parametrize(("header", "times", "note"), [
    ("Date", of_dates("%m/%d/%Y %I:%M:%S.%f %p"), f"dates, month/day/{ABOVE_12}"),
    ("Date", of_dates("%d/%m/%Y %H:%M:%S,%f"), f"dates, day/month/{ABOVE_12}"),
    ("Date", of_dates("{0.month}/{0.day}/%Y %H:%M:%S.%f"), f"dates, month/day/{ABOVE_12}"),
    ("time", of_dates("%I:%M:%S.%f %p", DATES - pandas.Timedelta(1, "s")), "from its first"),  # past noon
    ("time", of_dates("%Y/%m/%d/%H:%M:%S.%f"), "dates"), ("device_timestamp_ms", 1e3 * T, "ms"),
    ("ms", 1e3 * T, "ms"), ("elapsed (s)", T, "s"), ("TimeStartup [ns]", 1e9 * T, "ns"),
])  # fmt: skip
def test_times_by_headers_and_values(header, times, note):
    found = read({header: times, **quaternion()})
    assert found.time.values - found.time.values[0] == pytest.approx(T, abs=1e-12)
    assert f"time: column {header!r}, {note}; " in found.notes
    assert header != "Date" or found.attrs["start"] == LATER[0].timestamp()


def test_ambiguous_date():
    dates = of_dates("%d/%m/%Y %H:%M:%S.%f", DATES)
    both = "both the first and the second number are above 12 in some row"
    mixed = ["13/01/2026 12:00:00", *["01/13/2026 12:00:01"] * (N - 1)]
    for given, why in ((dates, "neither is above 12"), (mixed, both)):
        columns = {"Date": given, **quaternion()}
        assert f"time: not used: the column 'Date' holds '{given[0]}'" in read(columns).notes
        with refused("day-or-month", name="Date", value=given[0], why=why):
            read(columns, time_column="Date")


def test_messages_stay_short():
    with refused("no-orientation") as told:
        read("<html><body>" + "x" * 50_000 + "</body></html>\n")
    assert len(str(told.value)) < 500
    with refused("no-orientation") as told:
        read({f"a{k}z": T[:2] for k in range(500)})
    assert told.value.fields["names"].endswith(" and 440 more")


# formats


def objects(path):
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)


def of_another_file(path):
    """An array of MATLAB 7.3 whose numbers are kept in another file."""
    with h5py.File(path.with_name("other.h5"), "w") as file:
        file["secret"] = WXYZ.T
    with h5py.File(path, "w", userblock_size=512) as file:
        layout = h5py.VirtualLayout(shape=(4, N), dtype=float)
        layout[:] = h5py.VirtualSource(path.with_name("other.h5"), "secret", shape=(4, N))
        file.create_virtual_dataset("quat", layout)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def read_here(function, path):
    """What a library reads, not in a process of its own."""
    return function(str(path))


def markers_alone(path):
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [50]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["m"]
    file["data"]["points"] = np.zeros((4, 1, 3))
    file.write(str(path))


PAIR = quaternion("fore_qw fore_qx fore_qy fore_qz") | quaternion("up_qw up_qx up_qy up_qz", Q)
BOTH, TWO = {"arm": Q, "leg": Q, "t": T}, table({"time": T, **PAIR}).getvalue()
SIGNALS = {"time": T} | {f"r{i}{j}": i * np.sin(T + j) + i for i in (1, 2, 3) for j in (1, 2, 3)}
POINTS = {"time": T, "points": np.stack([np.sin(T), 1.2 + np.cos(T), 0.3 + T, 2 - T], axis=1)}
SCALED = {"time": T, **quaternion(values=np.round(WXYZ * 2**14).astype(int))}
ROUNDED = {"time": T, **quaternion(values=np.round(WXYZ * 20) / 20)}
MIXED = makers.mt_manager("\t", ("Acc", "Gyr", "Quat", "Euler", "Mat"))  # a matrix beside another quaternion
MIXED = MIXED.replace("Quat_q1", "Quat_qa").replace("Quat_q2", "Quat_q1").replace("Quat_qa", "Quat_q2")


def beside(**columns):
    return columns | quaternion()


def unlike(form, *names):
    """Columns that are no orientation."""
    return {"time": T} | {form.format(name, axis): T for name in names for axis in "xyz"}


BODIES = ("arm", "leg", "hip")
LATE, ABC = 4_000_000_000 + 16_667 * np.arange(N), {"columns": ["a", "b", "c"]}
RPY = "t,roll,pitch,yaw\n0,1,2,3\n1,1,2,3\n"


def no(code, content, file="a.csv", how=None, **fields):
    """A file that is refused by a code, with these among the fields of the message; arrays or columns are a table."""
    if isinstance(content, dict):
        content = partial(makers.npz, arrays=content) if file == "a.npz" else table(content).getvalue()
    return content, file, how or {}, code, fields


REFUSED = {
    "a gyroscope": no("gyroscope-alone", gyroscope(), gyroscope="Gyr_X, Gyr_Y, Gyr_Z"),
    "markers": no("markers", unlike("{}{}", "Elbow ", "ARM_", "wrist."), markers="Elbow, ARM, wrist"),
    "numbered markers": no("markers", unlike("{1}{0}", *"123"), markers="1, 2, 3"),
    "markers of OpenSim": no("markers", unlike("{1}{0}", *range(11, 34)), markers=", ".join(map(str, range(11, 34)))),
    "no markers, but angles": no("no-orientation", unlike("{} {} (mm)", *BODIES) | unlike("{} R {} (deg)", *BODIES)),
    "no markers": no("no-orientation", unlike("{}_{}", "pos", "vel", "force")),
    "sensors": no("no-orientation", unlike("{}_{}", "Acc", "Mag", "a", "LinearAcceleration", "Elbow")),
    "numbers of devices": no("several-sensors", {"device": [1.0, 2.0] * 30, "t": T,
        **quaternion(values=WXYZ * np.tile([[1, 1, 1, 1], [1, 0, 0, 0]], (30, 1)))}, names="1, 2"),
    "many lengths": no("not-rotations", "time,qw,qx,qy,qz\n" + "".join(f"{k},2,{k},0,0\n" for k in range(9)),
        what="quaternions", low=2),
    "two rows of signals": no("not-rotations", "7,1777037151.2,78,0.1,-9.2,-1.6,0.1,-8.7,-1.5\n" * 2, what="matrices"),
    "three of four": no("three-of-four", "qw,qx,qy\n1,0,0\n1,0,0\n", three="qw, qx, qy", fourth="qz"),
    "numbers of a quaternion": no("scalar-unknown", quaternion("q1 q2 q3 q4")),
    "no unit of time": no("no-time-unit", beside(time=20 * np.arange(N)), name="time", step=20),
    "ms with decimals": no("no-time-unit", beside(time=0.25 + 16.7 * np.arange(N)), name="time"),
    "ticks": no("no-time-unit", beside(SampleTimeFine=np.arange(N)), name="SampleTimeFine"),
    # Movella DOT, an hour after it was switched on: no seconds since 1970
    "late ticks": no("no-time-unit", beside(SampleTimeFine=LATE), step=16_667),
    "late ticks, by another name": no("no-time-unit", beside(timestamp=LATE)),
    "ns since a device started": no("no-time-unit", beside(t=951_412_773_297_707.375 + 8e6 * np.arange(N)), step=8e6),
    "a word": no("not-a-time", beside(time=["noon"] * N), name="time", value="noon"),
    **{wrong: no("not-a-time", beside(Date=[wrong] * N), how={"time_column": "Date"}, name="Date", value=wrong)
       for wrong in ("13:00:00 PM", "0:00:00 AM", "12/31/2026 25:00:00", "2/31/2026 10:00:00")},
    "a unit of dates": no("option-without-effect", beside(time=DATES), how={"time_unit": "ms"}),
    "a rate, and a column of times": no("rate-and-time", beside(time=T), how={"rate": 50, "time_column": "time"},
        name="time"),
    "two times": no("several-times", beside(time=T, t=3 * T), names="time, t"),
    "angles": no("angles", RPY),
    "angles beside few rates": no("angles", RPY.replace("yaw\n", "yaw,gx,gy,gz\n").replace("3\n", "3,0,0,1\n")),
    "no unit": no("no-angle-unit", RPY, how={"euler": "ZYX"}),
    "axes": no("euler", RPY, how={"euler": "ZZX"}),
    "which angles": no("which-angles", "t,a,b,c\n0,1,2,3\n", how={"euler": "ZYX"}),
    "three columns": no("three-columns", "a,b,c\n0,1,2\n", how=ABC),
    "which vector": no("which-angles", "a,b,c\n0,1,2\n", how={"rotation_vector": True}),
    "fields": no("fields", "t,qw,qx,qy,qz\n0,1,0,0,0\n0,1,0,0,0,7,8\n"),
    "segments": no("segments", makers.aem("TEME"), place="line 18", key="REF_FRAME_A"),
    "more fields": no("more-fields", "qw,qx,qy,qz\n0,1,0,0,0\n"),
    "fewer fields": no("more-fields", "t,qw,qx,qy,qz\n" + "0,1,0,0\n" * 3, headers=5, fields=4),
    "two quaternions": no("several-orientations", "qw,qx,qy,qz,qw,qx,qy,qz\n" + "1,0,0,0,1,0,0,0\n" * 2),
    **{f"thousands of ms, {one}": no("not-a-time",
        beside(time_ms=[f"{1000 + 20 * k:,}".replace(",", one) for k in range(N)]), value=f"1{one}000")
       for one in ", "},
    "thousands and decimal commas": no("not-a-time",
        table({"t": [f"{980 + 10 * k:,}.5".translate({44: ".", 46: ","}) for k in range(len(T))], **quaternion()},
            ";", decimal=",").getvalue(), value="1.000,5"),
    "thousands of a gyroscope": no("not-a-number", 't,a,b,c\n1.000,"1,000","2,000",0.5\n' * 2,
        how={**ABC, "rotation_vector": True}, value="1,000"),
    "thousands of s": no("thousands",
        table({"t": [f"{1 + t:.3f}" for t in T], **quaternion()}, ";", decimal=",").getvalue(), name="t"),
    "thousands of whole ms": no("thousands", beside(time_ms=[f"{20 * k:,}".replace(",", ".") for k in range(N)]),
        name="time_ms"),
    "underscores": no("not-a-time", beside(time=[f"0_{k}" for k in range(N)]), value="0_0"),
    "OpenSim": no("several-bodies", makers.sto(), "a.sto", names="torso_imu, humerus_imu"),
    "OpenSim, a name twice": no("same-name", makers.sto(("torso", "imu", "imu")), "a.sto", name="imu"),
    "OpenSim, no header": no("no-endheader", "no header\n1\t2\n", "a.sto"),
    "MVNX": no("several-bodies", mvnx(), "a.mvnx", names="Pelvis, LeftHand, sensor LeftHand"),
    "MVNX, a name twice": no("same-name", mvnx().replace("Pelvis", "LeftHand"), "a.mvnx", name="LeftHand"),
    "MVNX, cut short": no("unreadable", mvnx()[:2000], "a.mvnx", what="MVNX file"),
    "BVH": no("row-length", "\n".join([*bvh().split("\n")[:24], "1 2 3"]), "a.bvh", {"body": "Arm"}, place="line 25",
        what="motion", count=3, width=12),
    "BVH, channels of an end": no("hierarchy", bvh().replace("Site {", "Site { CHANNELS 1 Xrotation", 1), "a.bvh"),
    "BVH, channels twice": no("hierarchy", bvh().replace("CHANNELS 3", "CHANNELS 1 Xrotation\n CHANNELS 3"), "a.bvh"),
    "BVH, another axis": no("hierarchy", bvh().replace("Zrotation", "Wrotation"), "a.bvh"),
    "BVH, underscores": no("not-a-number", "\n".join([*bvh().split("\n")[:24], "1_0 " * 12]), "a.bvh", value="1_0"),
    **{f"BVH, {x}": no("no-frame-time", bvh().replace("0.02", x, 1), "a.bvh") for x in ("-0.02", "0", "nan", "inf")},
    "BVH, cut short": no("no-hierarchy", "HIERARCHY\nROOT a\n{\nCHANNELS 3 Xrotation", "a.bvh"),
    "NumPy, objects": no("unreadable", objects, "a.npy", what="NPY file"),
    "NumPy, scalar": no("scalar-unknown", BOTH, "a.npz", {"body": "leg"}, who="the array 'leg' does"),
    "NumPy, angles": no("attitudes", BOTH, "a.npz", {"euler": "ZYX"}, name="euler", names="arm, leg"),
    "NumPy, a vector": no("attitudes", BOTH, "a.npz", {"rotation_vector": True}, name="rotation_vector"),
    "NumPy, positions": no("not-rotations", POINTS, "a.npz", {"normalize": True, "scalar_first": True}),
    "NumPy, many bodies": no("several-bodies", {"t": T, "joints": np.stack([Q, Q, Q], axis=1)}, "a.npz",
        names="joints 0, joints 1, joints 2"),
    "NumPy, other axes": no("no-orientation", {"T_hand": np.zeros((4, 4, N)), "time": T}, "a.npz",
        names="time; not read: the array 'T_hand' of the shape (4, 4, 60)"),
    "MATLAB, of another file": no("unreadable", of_another_file, "a.mat", what="MAT file"),
    "C3D": no("no-rotations", markers_alone, "a.c3d"),
    "ROS": no("which-topic", partial(makers.ros, version=1), "a.bag", names="/imu, /pose, /odometry, /tf:base"),
    "SPICE": no("which-instrument", makers.spice_kernels, "a.tm", {"rate": 50, "body": "-1"}, names="-9000"),
    "SPICE, no rate": no("no-rate", makers.spice_kernels, "a.tm"),
    "SPICE, garbage": no("unreadable", "garbage", "a.tm", {"rate": 50}),
    "CSV": no("bodies-in-columns", TWO, bodies="fore, up"),
    "NumPy, words as times": no("not-a-time", {"fps": 50.0, "time": ["noon"] * N, "q": Q}, "a.npz",
        {"time_column": "time", "scalar_first": False}),
    "CSV, no body": no("no-body", TWO, how={"body": "leg"}, body="leg", names="fore, up"),
    "MT Manager, blanks": no("empty-fields", makers.mt_manager(" ").replace("      ", "   "), how={"rate": 50},
        headers=21, fields=16),
    "MT Manager, two": no("several-orientations", MIXED, how={"rate": 50}),
    "ZIP": no("packed", "PK\x03\x04", "a.zip", packed="a ZIP archive"),
    "gzip": no("packed", lambda path: path.write_bytes(gzip.compress(b"t,qw")), "a.csv.gz"),
    "JSON": no("json", '{"qw": [1]}', "a.json"),
    "AMC": no("skeleton", "#!OML:ASF motion\n:DEGREES\n1\nroot 0 0 0 1 2 3\narm 4 5 6\n", "a.amc"),
    "TRC": no("trc", "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\n100\t1\n", "a.trc"),
    "a spreadsheet": no("unknown-format", "PK\x03\x04\x00", "a.xlsx"),
    "CSV, nine channels": no("not-rotations", SIGNALS, how={"normalize": True}, what="matrices"),
    "CSV, counts": no("scaled", SCALED, rows="60 rows", place="line 2", what="quaternion", looks="scaled by 16383.9"),
    "CSV, rounded": no("scaled", ROUNDED, what="quaternion", looks="rounded"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_by_a_code(case, tmp_path):
    content, file, options, code, fields = REFUSED[case]
    path = makers.needed(made(content, file)).write(tmp_path)
    with refused(code, **fields):
        read_motion(path, **options)


PLAIN, OTHER_ARM = quat("q{}"), quat("Fore_{}", values=Q)
FORMS = "Upper_{}", "Shoulder {}", "r_{}", "Upper.q{}", "Upper_Quat_{}", "Upperq{}"
YPR = ("yaw", "pitch", "roll")
ANGLES = vector("{}", makers.EULER, YPR)
BAD = {
    name: [*column[:40], x, *column[41:]] for (name, column), x in zip(PLAIN.items(), (1.3, 0.2, 0.4, 0), strict=True)
}
BACK, MATRICES, SENSORS = R.inv().as_quat(), R.as_matrix(), {"time": T, "gyr": GYR, "acc": makers.ACC}
KEPT, MS, DOTTED = (
    np.delete(np.arange(N), [7, 8]),
    20 * np.arange(N),
    {"timestamp (+0200)": ["2023-05-04T10.11.12"] * N},
)
PAGES, WALK = {"R": np.moveaxis(MATRICES, 0, 2), "time": T}, np.random.default_rng(0).choice([-1, 1], N).cumsum()
COME_BACK = [Rotation.from_euler("z", x[:, None]) for x in (1 - np.cos(2 * np.pi * T), np.radians(40.0 * abs(WALK)))]
TWICE_Z = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Zrotation\n}\nMOTION\n"
inverted = partial(made, within=2e-6, says="the first is taken")  # by the angular velocity beside it


def archive(arrays, **how):
    return made(partial(makers.npz, arrays=arrays), "a.npz", **how)


SAID = {  # what is read, and a pattern of what is said of it
    "a name like time": made(text({"LocalTimeX": T, **PLAIN}), times=None, says="column 'LocalTimeX' may hold times"),
    "units that disagree": made(text({"lag (s)": T, "delay (s)": 2 * T, **PLAIN}), times=None,
                                says="column 'lag \\(s\\)' may hold times"),
    "packets": made(text({"PacketCounter": range(N), **PLAIN}), times=None, says="'PacketCounter' numbers the samples"),
    "empty": made(text({"SampleTimeFine": [""] * N, **PLAIN}), times=None, says="column 'SampleTimeFine' is empty"),
    "none": made(text(PLAIN), times=None, says="time: none"),
    "a damaged row": made(BAD, missing=1, says="missing: 1 row, which are not valid quaternions, the first is line 42"),
    "a damaged row, normalized": made(BAD, missing=1, normalize=True, says="missing: 1 row, .* the first is line 42"),
    "desired rolls": made(vector("Des{}", 0 * GYR, YPR) | ANGLES, euler="ZYX",
                          angle_unit="rad"),
    "angles that are named in another order": made(ANGLES, columns=[*YPR], euler="XYZ",
        angle_unit="rad", truth=Rotation.from_euler("XYZ", makers.EULER), says="the file states another order"),
    "an accelerometer": made(vector("Accelerometer {}", makers.ACC) | vector("rv {}", R.as_rotvec()),
                             rotation_vector=True, says="^orientation: rotation vector, rad: rv x, rv y, rv z; "),
    "comments": made(text({"time": T, **PLAIN}, between=["# paused, and resumed, twice, by hand, at noon", "// on"]),
                     says="left out: 2 lines of comments between the rows"),
    **{names: made(quat("q{}"), columns=names.split()) for names in ("qx qy qz qw", "qw qx qy qz")},
    **{f"a body, {form}": made(OTHER_ARM | quat(form), body=re.split(r"[_ .q{]", form)[0]) for form in FORMS},
    **{f"a body, {form}": made(OTHER_ARM | matrix(form), body="Upper")
       for form in ("Upper_{}{}", "Upper_r{}{}", "Upper_m_{}{}")},
    "a time in two columns, by their names": made(text({"Time": T + 1e-3 * np.sin(T), "stamp.secs": 10**9 + MS // 1000,
        "stamp.nsecs": MS % 1000 * 10**6, **PLAIN}), time_column="stamp.secs and stamp.nsecs"),
    "a matrix that is called T": made(matrix("T{}{}", 0)),
    "letters in brackets": made(quat("HIP ({})", values=Q) | quat("HEAD ({})"), body="head"),
    "a time beside one that is not understood": made(text({"epoc (ms)": 1_683_188_000_000 + MS, **DOTTED, **PLAIN}),
        says=r"^[^=]*not used: the column 'timestamp \(\+0200\)' holds '2023-05-04T10.11.12'[^=]*$"),
    "a rate, and a word": made(text({"time": ["tick"] * N, **PLAIN}), rate=50,
                               says="not used: the column 'time' holds 'tick'"),
    "a rate, and a word among times": made(text({"time": [*T[:3], "x", *T[4:]], **PLAIN}), rate=50,
                                           says="'time' is ignored, as a rate is given; time: 50 samples"),
    "a rate, and rounded times of a format": archive({"q": Q, "time": np.round(T, 1)}, scalar_first=False, rate=50),
    "a rate, and packets, two of which were lost": made(text({"PacketCounter": KEPT, **quat("q{}", values=WXYZ[KEPT])}),
        truth=R[KEPT], times=KEPT / 50, rate=50),
    "a rate in the file": archive({"fps": 50.0, **PLAIN}),
    "times beside a rate in the file": archive({"fps": 50.0, "time": 5 + T, "R": MATRICES}, says="^(?!.*times differ)"),
    "pages of MATLAB 7.3": made(partial(makers.mat73, arrays=PAGES), "a.mat"),
    "a structure of MATLAB 7.3": made(partial(makers.mat73, arrays={"s/" + k: v for k, v in PAGES.items()}), "a.mat"),
    "structures of MATLAB": made(partial(makers.mat, arrays={"s": PAGES, "u": [PAGES] * 2, "v": "x"}), "a.mat"),
    # turning points and steps like those beside them lose no rows; identities far from all others stand for lost ones
    **{f"a quaternion back at the identity, {k}": made(quat("q{}", values=np.roll(one.as_quat(), 1, axis=1)), truth=one)
       for k, one in enumerate(COME_BACK)},
    **{f"a matrix back at the identity, {k}": made(matrix("r{}{}", values=one.as_matrix()), truth=one)
       for k, one in enumerate(COME_BACK)},
    "lost rows": made(quat("q{}", values=np.where(np.isin(np.arange(N), [40, 41, 50])[:, None], [1.0, 0, 0, 0], WXYZ)),
                      says="missing: 3 rows, whose identities stand for lost ones, the first is line 42", missing=3),
    "times beside another rate in the file": archive({"fps": 25.0, "time": 5 + T, "R": MATRICES, "v": T[1:]},
        says="25 samples a second, from which the times differ"),
    "a rate in the file, and words": archive({"fps": 25.0, "time": ["noon"] * N, "R": MATRICES}, times=2 * T,
        says="matrix of 'R'.*not used: the column 'time' holds 'noon'.*as the format defines, s(?!.*noon)"),
    **{f"BVH, {k} frames of 2": made(f"{TWICE_Z}Frames: {k}\nFrame Time: 0.1\n10 20 30\n40 50 60\n", "a.bvh",
        truth=Rotation.from_euler("ZXZ", [[10, 20, 30], [40, 50, 60]], degrees=True), times=[0, 0.1], says=told)
       for k, told in ((2, "^(?!.*cut short)"), (5, "the file states 5 frames and holds 2: cut short"))},
    **{f"{kind}, inverted": inverted(partial(makers.ros, version=1, topics=[("/imu", kind)], attitudes=BACK), "a.bag")
       for kind in ("sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry")},
    "SPICE, inverted": inverted(partial(makers.spice_kernels, attitudes=R.inv()), "a.tm", rate=50),
    "MVNX, inverted": inverted(mvnx(R.inv()), "a.mvnx", body="LeftHand"),
    "APDM, inverted": inverted(makers.apdm(), body="Lower"),
    "NumPy, inverted": inverted(partial(makers.npz, arrays={"attitude": R.inv().as_matrix(), **SENSORS}), "a.npz"),
}  # fmt: skip


@pytest.mark.parametrize("name", SAID)
def test_doubtful_motions_warn(name, tmp_path, monkeypatch):
    monkeypatch.setattr(libraries, "read_apart", read_here)
    found = require_motion(makers.needed(SAID[name]), tmp_path)
    if name.startswith("times beside"):
        assert np.array_equal(found.time, 5 + T)


def test_opensim_rotation():
    """That of the last frame in ground, by SimTK::Rotation."""
    last = [
        [0.934227080753713, 0.24852452834453098, 0.25584237412423283],
        [-0.02313259708242066, 0.7579979454246571, -0.6518466059466912],
        [-0.35592786423461975, 0.6030544532155674, 0.7138912255506824],
    ]
    assert abs(rotation(read_motion(makers.DATA / "readers/opensim.sto"))[-1].as_matrix() - last).max() < 1e-14


@pytest.mark.parametrize("words", ["", "Type|Name|ID"])
def test_motive(words):
    """Formats 1.23 and 1.21, which has no words before the types, names and identities."""
    lines = makers.motive({"arm": Q}).split("\n")
    more = ["", "", *[",".join([name] * 3) for name in ("Marker", '"arm:Marker1"', '"DF9A05"', "Position")], "X,Y,Z"]
    lines = [f"{line},{end}" for line, end in zip(lines, [*more, *["1,2,3"] * N], strict=True)]
    lines[7 + 4] = ",".join(["4", f"{T[4]}", *[""] * 7, "1,2,3"])
    found = read(re.sub(rf"(?m)^,({words}),", ",,", "\n".join(lines)))
    kept = np.delete(np.arange(N), 4)
    assert missing(found) == [4]
    same(found[kept], R[kept], tolerance=1e-9)
    assert found.time.values == pytest.approx(T)


@pytest.mark.parametrize(("first", "second"), [('index="', 1 / 60), ('index="7', 0.017)])
def test_times_of_mvnx(first, second, tmp_path):
    """Also where they are in s, unless indices are no such numbers."""
    text = mvnx(step=1 / 60).replace('index="', first)
    for written in (text, re.sub(r'time="(\d+)"', lambda found: f'time="{int(found[1]) / 1000}"', text)):
        path = made(written, "a.mvnx").write(tmp_path)
        assert read_motion(path, body="LeftHand").time.values[1] == pytest.approx(second, rel=1e-7)
    assert "checked" not in read_motion(path, body="Pelvis").notes  # it is at rest


def test_decimal_marks():
    """The first 250 rows have what may be thousands alone, or no mark; the last ones tell."""
    text = "t\tqw\tqx\tqy\tqz\n" + "".join(f"{k}\t1\t0\t0\t0\n" for k in range(250))
    same(read(text + "250\t0,6\t0\t0\t0,8\n")[-1:], Rotation.from_quat([[0, 0, 0.8, 0.6]]))
    text = "t\tqw\tqx\tqy\tqz\n" + "".join(f"{k},000\t1\t0\t0\t0\n" for k in range(1, 250))
    with refused("not-a-time", value="1,000"):
        read(text + "250,000\t0.6\t0\t0\t0.8\n")


@pytest.mark.parametrize("suffix", [*{reader: one for one, reader in reversed(READERS.items())}.values(), ".npz"])
def test_foreign_or_damaged_files(suffix, tmp_path, monkeypatch):
    if suffix == ".mat":
        monkeypatch.setattr(libraries, "read_apart", read_here)
    path, is_binary = made(TWO, f"a{suffix}").write(tmp_path), suffix in (".npy", ".npz", ".mat", ".c3d", ".bag")
    if is_binary:
        with refused("text-inside", suffix=suffix):
            read_motion(path)
    for content in [b"HIERARCHY MOTION"] if suffix == ".bvh" else [b"", bytes(range(256)) * 4]:
        path.write_bytes(content)
        with pytest.raises((ValueError, OSError)) as caught:
            read_motion(path, rate=50)
        assert type(caught.value).__module__.split(".")[0] in ("builtins", "nontwist"), caught.value
        assert len(str(caught.value)) < 400
    if is_binary:
        assert caught.value.code == "unreadable"


def test_library_aborts(tmp_path, monkeypatch):
    (tmp_path / "library.py").write_text("import os\n\ndef read(path):\n    os.abort()\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RuntimeError, match=f"the process that reads it ended with -{signal.SIGABRT.value}"):
        libraries.read_apart(import_module("library").read, tmp_path / "x")


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [(".c3d", "ezc3d", "c3d"), (".bag", "rosbags.highlevel", "ros"), (".tm", "spiceypy", "spice")],
)
def test_missing_library(suffix, module, extra, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    path = made("x", f"a{suffix}").write(tmp_path)
    result = ended(2, "twist", path, "--rate", 50, "--out", tmp_path / "o")
    assert result.stderr == f"this format is read by {module}: pip install 'nontwist[{extra}]'\n"


@pytest.mark.parametrize(("missing", "in_all"), [
    (' time="180"', False), (r' time="\d+"', True), (' index="9"', False), (r' (time|index|ms)="\d+"', True),
])  # fmt: skip
def test_frames_of_mvnx(missing, in_all, tmp_path):
    """Where frames are lost, and one time, all times or an index is missing; without any, times are of the rate."""
    lines = [line for line in mvnx().split("\n") if not re.search(r'index="2\d"', line)]
    lines = [re.sub(missing, "", line) if in_all or 'index="9"' in line else line for line in lines]
    found = read_motion(made("\n".join(lines), "a.mvnx").write(tmp_path), body="sensor LeftHand")
    expected = np.arange(50) if "|" in missing else np.delete(np.arange(N), range(20, 30))
    assert found.time.values == pytest.approx(expected / 50)


def test_contradicted_unit():
    columns = {"t [ms]": [0, 10, 20], **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), [30.0] * 3)}
    found = read(columns, euler="xyz", angle_unit="deg", time_unit="ms")
    assert found.time[-1] == pytest.approx(0.02)
    assert "Euler angles xyz about fixed axes (extrinsic), deg: roll_deg, pitch_deg, yaw_deg" in found.notes
    with refused("angle-unit-stated", three="roll_deg, pitch_deg, yaw_deg", stated="deg", unit="rad"):
        read(columns, euler="xyz", angle_unit="rad")
    with refused("time-unit-stated", name="t [ms]", stated="ms", unit="s"):
        read(columns, euler="xyz", time_unit="s")


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
    "a gap": (
        [f"1.40,{ROWS[40].partition(',')[2]}"],
        "gaps",
        {"gaps": "1 gap", "first": -1, "last": 0, "step": pytest.approx(0.62)},
    ),
    "half a turn": (["0.80,0.6,0.8,0,0", "0.82,0,0,0.6,0.8"], None, "half a turn from line {0} to line {1}: "),
    "no rotation": (["0.80,2,0,0,0"], "missing-rows", DROPPED),
}
ABOVE = {"": "", "comments": "# a\n# b, c, d\n\n", "a preamble": "Device;x\n\nRate: 50\n"}


@pytest.mark.parametrize("first", ["0.0,nan,,,", "2026-03-01T12:00:00,nan,,,", "0.0,,,,"])
def test_missing_first_row(first):
    text = "\n".join(["time,qw,qx,qy,qz", first, first, *ROWS[2:]])
    if first.startswith("2026"):
        text = re.sub(r"\n(\d)\.", r"\n2026-03-01T12:00:0\1.", text)
    found = read(text)
    assert (len(found), missing(found)) == (N, [0, 1])
    same(found[2:], R[2:])


def test_no_samples_left():
    text = "time,qw,qx,qy,qz\n0,nan,0,0,0\n0.02,,,,\n0.04,0,0,0,0\n"
    with refused("too-few-samples", left=0, count=3) as told:
        twist(read(text))
    assert told.value.fields["why"].startswith(": dropped 3 rows")


def told_of(action, *arguments):
    """The error or the first warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            action(*arguments)
        except ValueError as error:
            return error
    return caught[0].message


def twisted(source):
    return twist(read_motion(source))


def agrees(told, code, fields):
    """Assert that this was told, with these among its fields."""
    assert told.code == code, told
    assert {name: told.fields[name] for name in fields} == fields


@pytest.mark.parametrize(
    ("case", "above", "between"),
    [
        *((case, "comments", "\n") for case in WRONG_LINES),
        *(("too many fields", *one) for one in (("", ""), ("a preamble", "# a, comment, of, 5, fields\n"))),
        ("no rotation", "", "  \n// one\n"),
    ],
)
def test_line_in_messages(case, above, between, tmp_path):
    wrong, code, fields = WRONG_LINES[case]
    rows = [*ROWS[:40], *wrong, *([] if case == "a gap" else ROWS[40 + len(wrong) :])]
    text = ABOVE[above] + "time,qw,qx,qy,qz\n" + "\n".join([*rows[:20], between + rows[20], *rows[21:]]) + "\n"
    lines = text.split("\n")
    at = lines.index(wrong[0]) + 1 if case != "a time again" else lines.index(ROWS[39]) + 2
    wide = made(text, "16.csv", encoding="utf-16").write(tmp_path)
    for source in (made(text).write(tmp_path), wide, io.StringIO(text)):
        told = told_of(twisted, source)
        if code is None:
            assert fields.format(at, at + 1) in str(told)
        else:
            places = {name: f"line {at + one}" if isinstance(one, int) else one for name, one in fields.items()}
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
def test_lines_as_in_an_editor(text, told):
    """Fields of several lines make rows that are not lines; fields that are all empty are rows."""
    with refused(told[0], **told[1]):
        read(text)


def test_lines_belong_to_the_samples(tmp_path):
    """Those of a selection keep theirs; arrays, and tables without lines, have rows, counted from 0."""
    text = "# a\n\ntime,qw,qx,qy,qz\n" + "\n".join(ROWS[:40]) + "\n\n" + "\n".join(ROWS[40:])
    motion = read(text)
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
    mirrored = {
        name: np.where(name.endswith("[3]") & (np.arange(N) == 7), -x, x) for name, x in matrix("Mat[{}][{}]").items()
    }
    told = told_of(twisted, table({"time": T, **mirrored}, head="# a\n"))
    assert str(told) == "rotation in line 10 is left-handed: its determinant is -1"


def test_files_of_different_lines():
    """Both have the same times: a row is missing in both, whichever has no number there."""
    one = read({"time": T, **quaternion()})
    values = np.where(np.arange(N)[:, None] == 5, np.nan, WXYZ)
    for head, place in (("", "line 7"), ("# a\n", "row 5")):
        other = read_motion(table({"time": T, **quaternion(values=values)}, head=head))
        told = told_of(partial(twist, relative_to=other), one)
        agrees(told, "missing-rows", {"rows": "1 row", "place": place})


@pytest.mark.parametrize(("wrong", "code", "fields"), [
    ("x", "not-a-number", {"what": "the column 'b'", "value": "x"}),
    ("0 0", "labels", {"count": 5, "labels": 4}),
])  # fmt: skip
def test_lines_of_opensim(wrong, code, fields, tmp_path):
    text = "joint angles\nversion=1\ninDegrees=yes\n\nendheader\ntime a b c\n\n0 1 2 3\n\n0.1 1 WRONG 3\n"
    read = partial(read_motion, columns=["a", "b", "c"], euler="ZXY")
    with refused(code, place="line 10", **fields):
        read(made(text.replace("WRONG", wrong), "a.mot").write(tmp_path))
    assert read(made(text.replace("WRONG", "nan"), "a.mot").write(tmp_path)).line.values.tolist() == [8, 10]


# times that a spreadsheet has rounded


def coarse(every, rate=100, seconds=20):
    """A steady turn about z by 1 rad/s with its times rounded to `every` s, as CSV, and its exact times."""
    t = np.arange(rate * seconds) / rate
    values = Rotation.from_rotvec(np.outer(t, [0, 0, 1])).as_quat()[:, [3, 0, 1, 2]]
    return table({"time": np.round(np.round(t / every) * every, 9), **quaternion(values=values)}), t


def rounded(rows, step, each, hertz):
    """The fields of a warning of rounded times, to three digits."""
    exact = {"rows": f"{rows} rows", "place": "line 3", "rate": f"rate={hertz}"}
    about = {"step": step, "each": each, "hertz": hertz, "half": step / 2}
    return exact | {name: pytest.approx(value, rel=5e-4) for name, value in about.items()}


@pytest.mark.parametrize(("every", "rate", "told"), [
    (0.1, 100, rounded(1799, 0.1, 10, 100)),
    (0.1, 60, rounded(999, 0.1, 6, 60)),
    (1.0, 50, rounded(979, 1, 50, 50)),
])  # fmt: skip
def test_rounded_times(every, rate, told):
    source, t = coarse(every, rate)
    agrees(told_of(twisted, source), "rounded-times", told)
    source.seek(0)
    motion = read_motion(source, rate=rate)
    assert np.array_equal(motion.time, t)
    average = (t.size - 1) / (np.round(np.round(t[-1] / every) * every, 9))
    ignored = f"time: the column 'time', {average:.4g} samples a second on average, is ignored, as a rate is given; "
    assert f"{ignored}time: {rate} samples a second; " in motion.attrs["notes"]
    result = twist(motion)
    assert result.attrs["notes"] == ""
    assert result.twist_angle[-1] == pytest.approx(t[-1], rel=1e-12)
    assert abs(result.twist_rate - 1).max() < 1e-9


def test_rate_beside_unnamed_columns():
    """The message on a first column that is no time advises --rate, which ignores it."""
    rows = "".join("quat," + ",".join(map(repr, one)) + "\n" for one in WXYZ.tolist())
    with refused("not-a-time"):
        read(rows, scalar_first=True)
    found = read(rows, scalar_first=True, rate=50)
    same(found)
    np.testing.assert_allclose(found.time, T)


def test_angular_velocities_are_named_likewise():
    """For `fit_inertia`: the line that has no number; rounded times, which a rate replaces."""
    gyroscope = {f"g{x} (rad/s)": column.astype(object) for x, column in zip("xyz", Q[:, :3].T, strict=True)}
    gyroscope["gy (rad/s)"][9] = None
    source = table({"time": T, **gyroscope}, head="# a\n\n")
    agrees(read_rates(source).warnings[0], "missing-rates", {"rows": "1 row", "place": "line 13"})
    with refused("not-a-number", what="the column 'gy (rad/s)'", value="x", place="line 13"):
        read_rates(io.StringIO(source.getvalue().replace(",,", ",x,")))
    t = np.arange(400) / 100
    source = table({"time": t.round(1), **{f"g{x} (rad/s)": np.sin(t + k) for k, x in enumerate("xyz")}})
    agrees(read_rates(source).warnings[0], "rounded-times", rounded(359, 0.1, 10, 100))
    source.seek(0)
    found = read_rates(source, rate=100)
    assert (found.time.tolist(), found.warnings) == (t.tolist(), ())


def test_devices_of_angular_velocities():
    """Told apart by a column, or by what is empty."""
    names, nothing = [f"g{x} (rad/s)" for x in "xyz"], np.full((N, 4), np.nan)
    for other, column, told in ((0 * Q, ["hand", "arm"] * N, {"body": "hand"}), (nothing, [np.nan, 12.5] * N, {})):
        both = zip(names, np.stack([Q, other], axis=1).reshape(-1, 4)[:, :3].T, strict=True)
        found = read_rates(table({"device": column, "time": np.repeat(T, 2), **dict(both)}), **told)
        assert np.array_equal(found.rates, Q[:, :3])
        assert (found.left_out, found.warnings) == (0, ())


def test_topics_of_angular_velocities(tmp_path, monkeypatch):
    monkeypatch.setattr(libraries, "read_apart", read_here)
    topics = [("/imu0", "sensor_msgs/msg/Imu"), ("/imu1", "sensor_msgs/msg/Imu")]
    arrays = {"data": {"time": T, "gyro": makers.GYR}, "spare": {"gyro": makers.ACC}}
    bags = [(partial(makers.ros, version=1, topics=topics[:count]), f"{count}.bag", "/imu0") for count in (1, 2)]
    for write, file, body in ((partial(makers.mat, arrays=arrays), "a.mat", "data.gyro"), *bags):
        found = read_rates(
            makers.needed(made(write, file)).write(tmp_path), body=body, unit="rad/s" if file == "a.mat" else None
        )
        assert abs(found.rates - makers.GYR).max() < 1e-9


def test_duplicates_in_a_part():
    """A logger that hung for half the recording; a file that is in there twice is no file to sort."""
    t = np.arange(2000) / 100
    values = quaternion(values=np.tile(WXYZ[:40], (50, 1)))
    hung = read({"time": np.where(t < 10, t, 10.0), **values})
    agrees(told_of(twist, hung), "duplicate-times", {"rows": "999 rows", "place": "line 1003"})
    twice = read({"time": np.tile(t[:1000], 2), **values})
    with refused("clock-goes-back", back=9.99, place="line 1002"):
        twist(twice)
    minute = read({"time (s)": 2.0 * np.tile(np.arange(30), 2), **quaternion(values=WXYZ[:60])})
    with refused("clock-goes-back", back=58):
        twist(minute)


@pytest.mark.parametrize("bits", [8, 16, 24, 31, 32])
def test_counters_that_wrap(bits):
    ticks = 2.0**bits - 7 + np.arange(20)
    found, words = counted_on(ticks % 2**bits, BITS)
    assert np.array_equal(found, ticks)
    assert words.endswith(f" {2**bits}")
    assert counted_on(ticks, BITS) == (pytest.approx(ticks, rel=0), "")


@pytest.mark.parametrize(
    ("gyroscope", "accelerometer"),
    [("gyro_rad[{}]", "accelerometer_m_s2[{}]"), ("gyroADC[{}] (deg/s)", "accSmooth[{}] (g)")],
)
def test_numbered_axes(gyroscope, accelerometer):
    """As PX4 and Betaflight write them; numbers of joints are no axes."""
    names = [form.format(k) for form in (gyroscope, accelerometer, "motor[{}]", "joint{} (deg/s)") for k in range(3)]
    assert headers.sensors(names, headers.GYROSCOPE) == [("", tuple(names[:3]))]
    assert headers.sensors(names, headers.ACCELEROMETER) == [("", tuple(names[3:6]))]


def test_instances_in_turn():
    """As ArduPilot writes its sensors: rows of two, of nearly the same readings, at the same times."""
    t = np.repeat(np.arange(0, 1, 0.02), 2)
    table = pandas.DataFrame({"TimeUS": (1e6 * t).astype(int), "I": np.tile([0, 1], 50)})
    for name, x in zip(
        ("qx", "qy", "qz", "qw"), Rotation.from_rotvec(np.outer(t, [0, 0, 1.0])).as_quat().T, strict=True
    ):
        table[name] = x
    with refused("several-sensors", header="I"):
        read_motion(table)
    assert read_motion(table, body="1").sizes["time"] == 50
