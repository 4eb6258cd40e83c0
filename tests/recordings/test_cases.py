"""Recordings that version 0.2.0 read wrongly, or refused without the remedy, and siblings of each.

Files of the cases lie in data/cases; a sibling is of another maker or format, has the same kind of fault, and a motion
whose twist is known.
"""

import gzip
import io
import json
import re
import zipfile
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from conftest import ended, nontwist
from nontwist import read_motion, simulate, standard
from nontwist.recordings.reading import read_rates

from . import makers
from .makers import EULER, GYR, N, Q, R, T, columns, quat, text, vector

FOLDER = makers.DATA / "cases"
STORED = {file.name for file in FOLDER.iterdir()}
PSI = 4.92139  # rad: the twist of the motion in most files of the cases, over 6 s
TWIST = quad(lambda t: makers.spins(np.array([t]))[0, 2], 0, T[-1])[0]  # rad: that of the motion of the makers


@dataclass(frozen=True)
class Case:
    """A command on a recording.

    Attributes
    ----------
    arguments : files and options of `nontwist twist`; the first file may be the second as well
    files : mapping of name to content: text, bytes, or what writes it; those of data/cases need none
    value : the total twist, rad; None where only a refusal is right
    refusal : pattern that the message of a refusal has, where one is permitted
    says : pattern of what is said about the reading, in the output or a warning
    duration : of the samples, s
    within : of the value, rad
    """

    arguments: tuple[str, ...]
    files: dict = field(default_factory=dict)
    value: float | None = PSI
    refusal: str = ""
    says: str = ""
    duration: float | None = None
    within: float = 1e-5


def case(line, **told):
    """A case by its command."""
    return Case(tuple(line.split()), **told)


def own(content, file="a.csv", options=(), value=TWIST, **told):
    """A sibling of one file, of the motion of the makers unless another value is told; columns are a CSV with times."""
    content = text({"time": T, **content}) if isinstance(content, dict) else content
    return Case((file, *options), {file: content}, value, **told)


def written(content, path):
    """Write text, bytes, or what a function writes."""
    if callable(content):
        content(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())


# two bodies that move on their own; the twist of the joint is the last of its angles

T6 = np.arange(301) / 50


def arm(t):
    return Rotation.from_euler("XY", np.stack([0.5 * np.sin(1.3 * t), 0.4 * np.sin(0.9 * t + 1)], axis=1))


def hand(t):
    return arm(t) * Rotation.from_euler("YZ", np.stack([0.3 + 0.7 * np.sin(1.9 * t), 0.9 * np.sin(2.3 * t)], axis=1))


JOINT = 0.9 * np.sin(2.3 * T6[-1])
FINE = hand(np.linspace(0, 6, 100_001))
TWIST_OF_HAND = (FINE[:-1].inv() * FINE[1:]).as_rotvec()[:, 2].sum()


def scalar_first(attitudes):
    return np.round(np.roll(attitudes.as_quat(), 1, axis=1), 10)


OF_HAND, OF_ARM = scalar_first(hand(T6)), scalar_first(arm(T6))


def in_turn(ids):
    """Rows of the hand and of the arm in turn, told apart by the first column."""
    table = {"Device name": [one for _ in T6 for one in ids], "time": np.repeat(T6, 2)}
    return text(table | quat("q{}", values=np.stack([OF_HAND, OF_ARM], axis=1).reshape(-1, 4)), "\t")


def two_publishers(writer, store):
    """Two nodes publish /tf: the first the hand, the second the arm, which rests."""
    opened = [
        writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store, callerid=f"/{name}")
        for name in ("hand", "arm")
    ]
    for k in range(N):
        for connection, name, turned in zip(opened, ("hand", "arm"), (Q, 0 * Q + [0, 0, 0, 1]), strict=True):
            message, stamp = makers.ros_message(store, 1, connection.msgtype, k, ("map", name), turned)
            makers.ros_write(writer, store, 1, connection, message, stamp + 5)


def merged():
    """Three topics merged on time: the hand, the arm 8 ms before it, and a battery."""
    early = np.append(T6, 6.02) - 0.008
    rows = [[t, *[""] * 4, *q, ""] for t, q in zip(early.tolist(), scalar_first(arm(early)).tolist(), strict=True)]
    rows += [[t, *q, *[""] * 5] for t, q in zip(T6.tolist(), OF_HAND.tolist(), strict=True)]
    rows += [[t, *[""] * 8, 12.5] for t in (T6 + 0.003).tolist()]
    names = ["time", *quat("/hand/{}"), *quat("/arm/{}"), "/battery"]
    return text(dict(zip(names, zip(*sorted(rows, key=lambda row: row[0]), strict=True), strict=True)), "\t")


# content of siblings

RAD, DPS = vector("gyr_{} (rad/s)", GYR), vector("gyr_{} (deg/s)", np.degrees(GYR))
ZXY = columns("{} (deg)", ("heading", "pitch", "roll"), R.as_euler("ZXY", degrees=True))  # roll is about y
PLAIN = quat("q{}")


def of_angles(letters, angles, degrees):
    turned = Rotation.from_euler(letters, angles, degrees=degrees)
    return (turned[:-1].inv() * turned[1:]).as_rotvec()[:, 2].sum()


THREE = of_angles("XYZ", EULER[:, ::-1], False)  # read wrongly, as options tell
SMALL = of_angles("ZYX", EULER, True)
KEPT = np.delete(np.arange(N), range(20, 25))
START_DAY = datetime(2026, 3, 31, 12, 59, 59, 500_000)
UTC_START = int(START_DAY.replace(tzinfo=UTC).timestamp()) - 7200  # two hours before that, s since 1970
DATES = [START_DAY + timedelta(milliseconds=20 * k) for k in range(N)]
LATE = [d + timedelta(hours=11) for d in DATES]  # into the next day
YPR, ROTVEC = ("yaw", "pitch", "roll"), R.as_rotvec(degrees=True)
DATES_6 = [START_DAY + timedelta(milliseconds=20 * k) for k in range(301)]
MS = 20 * np.arange(N)
MARKS = np.stack([np.sin(T), 1.2 + np.cos(T), 0.3 + 0.4 * T, 2 - T], axis=1)  # m, of something that is no rotation
SENSOR = {f"r{i + 1}{j + 1}": (1 + 0.3 * i) * np.sin(T + j) + i for i in range(3) for j in range(3)}
PAGES = np.zeros((N, 4, 4)) + np.eye(4)
PAGES[:, :3, :3] = R.as_matrix()
PAUSE = np.outer(np.maximum(T - 0.68, np.minimum(T - 0.5, 0)), [0, 0, 1.0])  # rad, at rest from 0.5 to 0.68 s
MANY = np.stack([0 * Q + [0, 0, 0, 1], Q, Q], axis=1)  # (n, bodies, 4)


def lost(values, instead):
    """Quaternions of which five in a row are replaced."""
    values = values.copy()
    values[20:25] = instead
    return values


def clocked(header, times, **dialect):
    return text({header: times, **PLAIN}, **dialect)


def structured(names, *fields):
    return partial(makers.npy, arrays=np.rec.fromarrays(fields, names=names))


def twice(pattern, letters, values):
    """Columns of zeros before others with the same headers."""
    other = columns(f"{pattern}#", letters, 0 * values)
    return text({"time": T, **other, **columns(pattern, letters, values)}).replace("#", "")


def zipped():
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        file.writestr(zipfile.ZipInfo("a.csv"), clocked("time", T))
    return packed.getvalue()


def of_excel(content):
    """A storage file of OpenSim that a German spreadsheet has saved."""
    head, rows = content.split("endheader\n")
    return head + "endheader;;;\n" + rows.replace("\t", ";").replace(".", ",")


HOURS = r"(?i)(time zone|whole hours?|h apart)"


def two_files(one, other, *options):
    """The hand relative to the arm, from two tables."""
    files = {"a.csv": one, "b.csv": other}
    return Case(("a.csv", "--relative-to", "b.csv", *options), files, JOINT, HOURS, within=1e-4)


def table_of(header, times, values, **dialect):
    return text({header: times, **quat("q{}", values=values)}, **dialect)


BIPED, FORE_UPPER = "biped_names.bvh", "two_sensors_forearm.csv --relative-to two_sensors_upperarm.csv"
NAMED_TWICE = r"(?i){}.*(twice|two|repeat|more than one|more than once|again)"
IDS = r"(?s)SensorId.*\b1\b.*\b2\b"
NO_ROTATION = r"(?is)^(?!.*--normalize).*(no|not a|not) (valid )?rotation"
BACK = r"(?is)(back|midnight|wrap|anew|over|day|week|2\^?31|counter)"
GONE = {"within": 2e-3, "says": r"(?i)(dropped|missing|left out|lost)"}  # a gap of 0.12 s or 0.2 s is bridged

CASES = {
    "A1": case("two_connections.bag"),
    "A1, sibling: two publishers of /tf": own(partial(makers.ros, version=1, write=two_publishers), "a.bag",
        ("--body", "/tf:hand")),
    "A2": case("interleaved.csv", value=-0.304461, refusal=IDS),
    "A2, same times": case("interleaved_same_time.csv", value=-0.304461, refusal=IDS, says="SensorId"),
    "A2, sibling: names of devices": own(in_turn(("hand", "arm")), "a.tsv", value=None,
        refusal=r"(?s)Device name.*hand.*arm"),
    "A2, sibling: the name as the body": own(in_turn(("hand", "arm")), "a.tsv", ("--body", "hand"), TWIST_OF_HAND),
    "A2, sibling: floats": own(in_turn((1.0, 2.0)), "a.tsv", value=None, refusal=r"Device name.*\b1, 2\b"),
    "A2, sibling: no names": own(in_turn(("hand", "arm")).replace("hand\t", "").replace("arm\t",
        "").replace("Device name\t", ""), "a.tsv", value=TWIST_OF_HAND, says="in turn"),
    "A2, parts of one motion": own(text({"segment": ["arm"] * 30 + ["leg"] * 30, "time": T, **PLAIN})),
    "A3": case("mislabelled_gyro.csv", says="gyroscope"),
    "A3, --scalar-first": case("mislabelled_gyro.csv --columns qx,qy,qz,qw --scalar-first"),
    "A3, sibling: a structured array": own(structured(["time", "qw", "qx", "qy", "qz", *RAD], T, *Q.T, *GYR.T), "a.npy",
        says="gyroscope"),
    "A3b": case("coremotion.csv --euler ZXY --angle-unit rad", says="gyroscope"),
    "A3b, sibling: degrees, tabs": own(text({"time": T, **ZXY, **DPS}, "\t"), "a.txt", ("--euler", "ZXY"),
        says="gyroscope"),
    "A3, a gyroscope with other axes": own({**PLAIN, **vector("gyr_{} (rad/s)", GYR[:, [1, 2, 0]])},
        says="^(?!.*no reading)"),
    "A3, sibling: headers alone": own({**quat("q{}", values=Q)}, options=("--columns", "qw,qx,qy,qz", "--scalar-last"),
        says="another order"),
    "A3, sibling: the gyroscope of another": own({**quat("a1 q{}"),
        **quat("a10 q{}", values=makers.WXYZ * [1, -1, -1, -1]), **vector("a10 gyr_{} (rad/s)", -makers.SPACE)},
        options=("--body", "a1")),
    "A3, sibling: degrees as radians": own({**columns("rotvec_{}", "xyz", R.as_rotvec(degrees=True)), **RAD},
        options=("--rotation-vector",), says="gyroscope"),
    "A3b, sibling: options": own({**columns("{} (deg)", ("yaw", "pitch", "roll"), np.degrees(EULER)), **PLAIN}, "a.csv",
        ("--euler", "XYZ"), THREE, within=1e-3, says="ZYX about moving axes.*wrong"),
    "A3b, sibling: a unit": own({**columns("{}", ("yaw", "pitch", "roll"), EULER), **DPS},
        options=("--euler", "ZYX", "--angle-unit", "deg"), value=SMALL, says="rad: yaw, pitch, roll.*wrong"),
    "A4": case(BIPED, value=None, refusal=r"(?s)Bip01.*Bip01 Spine.*Bip01 Head"),
    "A4, the spine": Case((BIPED, "--body", "Bip01 Spine")),
    "A4, the head": Case((BIPED, "--body", "Bip01 Head"), value=11.2046, within=1e-4),
    "A4, sibling: .sto": own(makers.sto(("torso", "imu", "imu")), "a.sto", value=None,
        refusal=NAMED_TWICE.format("imu")),
    "A4, sibling: .mvnx": own(makers.mvnx().replace("Pelvis", "LeftHand"), "a.mvnx", value=None,
        refusal=NAMED_TWICE.format("LeftHand")),
    "A4, sibling: .c3d": own(partial(makers.c3d, labels=("pelvis", "arm", "arm")), "a.c3d", value=None,
        refusal=NAMED_TWICE.format("arm")),
    "A5": case("position_xyz_w.csv"),
    "A5, --normalize": case("position_xyz_w.csv --normalize"),
    "A5, sibling: an array": own(partial(makers.npz, arrays={"time": T, "points": MARKS}), "a.npz",
        ("--normalize", "--scalar-first"), None, refusal=NO_ROTATION),
    "A5, sibling: nine channels": own(text({"time": T, **SENSOR}, "\t"), "a.tsv", ("--normalize",), None,
        refusal=NO_ROTATION),
    "A6": case(FORE_UPPER, value=-0.954935),
    "A6, sibling: .npz": Case(("a.npz", "--scalar-first", "--relative-to", "b.npz", "--relative-options",
        "--scalar-first"), {f"{name}.npz": partial(makers.npz, arrays={"time": T6, "q": q}) for name,
        q in (("a", OF_HAND), ("b", OF_ARM))}, JOINT),
    "A6, sibling: times of day": Case(("a.csv", "--relative-to", "b.csv"),
        {"a.csv": table_of("time", [f"{d:%H:%M:%S.%f}" for d in DATES_6], OF_HAND),
        "b.csv": table_of("time", [f"{d:%H:%M:%S.%f}" for d in DATES_6[50:]], OF_ARM[50:])},
        JOINT - 0.9 * np.sin(2.3 * T6[50]), duration=5),
    "A6, sibling: dates of one": Case(("a.csv", "--relative-to", "b.csv"),
        {"a.csv": table_of("time", T6, OF_HAND), "b.csv": table_of("time", [f"{d}" for d in DATES_6], OF_ARM)}, None,
        "the clocks cannot be aligned"),
    "B1, midnight": case("midnight.csv", refusal=BACK, duration=6),
    "B1, 2^31 µs": case("counter31.csv", refusal=BACK, duration=6),
    "B1, second of the day": case("second_of_day.csv", refusal=BACK, duration=6),
    "B1, sibling: 16 bits of ms": own(clocked("time_ms", (65_000 + MS) % 2**16, sep="\t"), "a.tsv", refusal=BACK,
        duration=1.18),
    "B1, sibling: GPS week": own(clocked("time (s)", (604_799.5 + T) % 604_800), refusal=BACK, duration=1.18),
    "B1, sibling: 12 hours": own(clocked("time", [f"{d:%I:%M:%S.%f}" for d in DATES], sep=";"), refusal=BACK,
        duration=1.18),
    "B1, sibling: floats at 2^32": own(clocked("time_us", (2.0**32 - 500_000 + 1000 * MS) % 2**32), refusal=BACK,
        duration=1.18),
    "B1, sibling: second of the minute": own(clocked("seconds", (59.5 + T) % 60), duration=1.18),
    "B1, two recordings of a minute": own(clocked("time (s)", 60.0 * np.r_[:30, :30] / 30), value=None,
        refusal=r"the clock goes back by 58"),
    "B2": case("tracker_missing.csv", duration=6, **GONE),
    "B2, sibling: -9999": own(text({"time": T, **quat("Quat_{}", "WXYZ", lost(scalar_first(R), -9999.0))}, "\t"),
        "a.tsv", **GONE),
    "B2, sibling: repeated identities": own(makers.motive({"hand": lost(Q, [0, 0, 0, 1])}), **GONE),
    "B2, sibling: far from length 1": own({**quat("q{}", values=lost(scalar_first(R), [0.01, 0, 0, 0.02]))}, **GONE),
    "B2, sibling: a row that is held": own({**quat("q{}", values=lost(scalar_first(R), scalar_first(R)[19]))},
        says="5 rows, which repeat the one before, until a jump, the first is line 22", within=2e-3),
    "B2, sibling: identities at the start": own(text({"time": T,
        **quat("q{}", values=np.where(T[:, None] < 0.1, [1.0, 0, 0, 0], makers.WXYZ))}), within=2e-4,
        value=TWIST - quad(lambda t: makers.spins(np.array([t]))[0, 2], 0, T[5])[0], says="dropped 5 rows"),
    "B2, sibling: a rest at the identity": own(text({"time": T,
        **quat("q{}", values=scalar_first(Rotation.from_rotvec(PAUSE)))}), value=1.0, duration=1.18),
    "B2, sibling: angles": own({**columns("{} (deg)", ("yaw", "pitch", "roll"), lost(np.degrees(EULER), -9999.0))},
        "a.csv", ("--euler", "ZYX"), **GONE),
    "B3": case("nanoseconds.csv", duration=6),
    "B3, sibling: date and time of day": own(text({"Date": [f"{d:%d.%m.%Y}" for d in LATE],
        "Time": [f"{d:%H:%M:%S,%f}" for d in LATE], **PLAIN}, ";", decimal=","), duration=1.18),
    "B3, sibling: seconds and ms": own(text({"time_s": makers.START + MS // 1000, "time_ms": MS % 1000, **PLAIN}, "\t"),
        "a.tsv", duration=1.18),
    "B4, an hour": two_files(table_of("time", [d.isoformat() + "Z" for d in DATES_6], OF_HAND),
        table_of("time", [(d + timedelta(hours=1)).isoformat() for d in DATES_6], OF_ARM)),
    "B4, sibling: since 1970": two_files(table_of("timestamp", 1000 * UTC_START + 500 + 20 * np.arange(301), OF_HAND),
        table_of("Datum", [f"{d:%d.%m.%Y %H:%M:%S.%f}" for d in DATES_6], OF_ARM, sep=";")),
    "B4, sibling: the next day": Case(("a.csv", "--relative-to", "b.csv"),
        {"a.csv": table_of("time", [f"{d}" for d in DATES_6], OF_HAND),
        "b.csv": table_of("time", [f"{d + timedelta(days=1)}" for d in DATES_6], OF_ARM)}, None, "24 hours apart"),
    "B5": case("emg33.csv", duration=6),
    "B5, sibling: pressure": own(text({"time": T, **quat("Quat_{}", "WXYZ"),
        **{key.replace("r", "P"): x for key, x in SENSOR.items()}}, "\t"), "a.tsv"),
    # over all rows of the hand: the first row of the arm is 8 ms after that of the hand
    "B6": case("sparse.csv --body /hand --relative-to sparse.csv --relative-body /arm", value=-0.507723, within=2e-5),
    "B6, sibling: three topics": own(merged(), "a.tsv", ("--body", "/hand", "--relative-to", "a.tsv", "--relative-body",
        "/arm"), JOINT, within=1e-4),
    "B7": case("emoji_names.bvh", value=None, refusal="man:leg:a.*man:foot:b.*man:hand:c"),
    "B7, one": case("emoji_names.bvh --body man:foot:b", says="man:foot:b"),
    "B7, sibling: columns": own({**quat(":leg:q{}"), **quat(":hand:q{}")}, value=None, refusal=":leg:.*:hand:"),
    "B8": case("poses_n44.npy --rate 50", refusal=r"301.*4.*4", duration=6),
    "B8, poses": case("body_poses.npz", value=None, refusal=r"poses 0, poses 1, .*poses 51"),
    "B8, the root of the poses": Case(("body_poses.npz", "--body", "poses 0")),
    "B8, sibling: .mat": own(partial(makers.mat, arrays={"T_hand": np.moveaxis(PAGES, 0, 2), "time": T}), "a.mat",
        refusal=r"T_hand.*4.*4.*60"),
    "B8, sibling: a rate": own(partial(makers.mat, arrays={"q": Q, "rate": 50.0}), "a.mat", ("--scalar-last",),
        duration=T[-1]),
    "B8, sibling: bodies in an array": own(partial(makers.npz, arrays={"time": T, "joints": MANY}), "a.npz", value=None,
        refusal=r"joints 0, joints 1, joints 2"),
    "B9, decimal commas": case("decimal_comma.bvh --body Chest", duration=6),
    "B9, endheader": case("endheader_commas.mot --columns rx,ry,rz --euler XYZ", value=np.radians(40), duration=0.2),
    "B9, sibling: a spreadsheet": own(of_excel(makers.mot(degrees=True)), "a.mot",
        ("--columns", "free_rot_x,free_rot_y,free_rot_z", "--euler", "XYZ")),
    "B9, sibling: Quaternions 0()": own(text({"time": T, **quat("Quaternions {}()", "0123")}, "\t"), "a.txt",
        ("--scalar-first",)),
    "B9, sibling: Q0 Qx Qy Qz of tools": own(text({"Time [sec]": T, **quat("Tool1 Q{}", "0xyz"),
        **quat("Tool2 Q{}", "0xyz", 0 * Q + [1, 0, 0, 0])}, ";"), options=("--body", "Tool1"), duration=1.18),
    "B10, .zip": own(zipped(), "a.zip", refusal=r"(?i)unpack"),
    "B10, .gz": own(gzip.compress(clocked("time", T).encode(), mtime=0), "a.csv.gz", refusal=r"(?i)unpack"),
    "B10, .json": own(json.dumps({name: np.asarray(column).tolist() for name, column in PLAIN.items()}), "a.json",
        refusal="JSON"),
    "B11, elapsed_s": own(clocked("elapsed_s", T), duration=1.18),
    "B11, minutes": own(clocked("time", [f"50:{12.3 + t:05.2f}" for t in T]), duration=1.18),
    "B11, Excel": own(clocked("DateTime", [f"{46_112.5 + t / 86_400:.12f}" for t in T]), duration=1.18, refusal="day"),
    "B11, datenum": own(clocked("datenum", [f"{740_072.5 + t / 86_400:.10f}" for t in T], sep="\t"), "a.tsv",
        refusal="day", duration=1.18),
    "B11, sibling: Julian days": own(clocked("Julian date", [f"{2_461_131.25 + t / 86_400:.10f}" for t in T]),
        duration=1.18, says="Julian days"),
    "B11, sibling: ticks of .NET": own(clocked("Timestamp", 639_105_768_000_000_000 + 10_000 * MS), duration=1.18,
        says="ticks of .NET"),
    "B11, sibling: years, months, days": own(text({"Year": [2026] * N, "Month": [3] * N, "Day": [31] * N,
        "Hour": [12] * N, "Minute": [59] * N, "Second": 58.5 + T, **PLAIN}, "\t"), "a.tsv", duration=1.18,
        says="Year Month Day Hour Minute Second"),
    "B11, a unit of dates": own(clocked("time", [f"{d}" for d in DATES]), options=("--time-unit", "ms"), value=None,
        refusal="has no effect"),
    "C1, a header twice": own(twice("{} (deg)", YPR, np.degrees(EULER)), options=("--euler", "ZYX", "--columns",
        "yaw (deg).1,pitch (deg).1,roll (deg).1")),
    "C1, sibling: a vector": own(twice("r{}_deg", "xyz", ROTVEC), options=("--rotation-vector", "--columns",
        "rx_deg.1,ry_deg.1,rz_deg.1")),
    "C1, sibling: no columns": own(twice("{} (deg)", YPR, EULER), options=("--euler", "ZYX"), value=None,
        refusal="not clear"),
    "C1, sibling: no unit": own(vector("r{}", np.outer(T, [0, 0, 57.3])), options=("--rotation-vector",),
        value=57.3 * T[-1], says="67.61 rad long.*--angle-unit"),
    "C2, a matrix beside": own({**columns("{} (deg)", YPR, np.degrees(EULER)), **makers.matrix("r{}{}")}, "a.csv",
        ("--euler", "XYZ"), THREE, within=1e-3, says="ZYX about moving axes.*wrong"),
    "C2, sibling: Qualisys": own(makers.qualisys({"arm": R, "leg": R.inv()}), "a.tsv", ("--body", "arm", "--euler",
        "ZYX", "--angle-unit", "deg"), of_angles("ZYX", R.as_euler("XYZ")[:, ::-1], False), within=3e-3,
        says="XYZ about moving axes.*wrong"),
    "C3, lost packets": own(text({"PacketCounter": KEPT, **quat("q{}", values=makers.WXYZ[KEPT])}), within=2e-3,
        says="numbers 5 samples .* before line 22; --rate"),
    "B11, ms by the gyroscope": own(text({"time": MS // 20, **PLAIN, **vector("gyr_{} (rad/s)", 20 * GYR)}),
        says="^(?!.*no reading).*in ms, by the gyroscope", duration=0.059),
    "B11, sibling: elapsed ms": own(clocked("Elapsed_ms", MS, sep=";"), "a.txt", duration=1.18),
}  # fmt: skip

# angular velocities: the content, options of the reading, the truth or what a refusal says

RECORDS = r"(?i)(record|begin|kinds? of (rows|lines))"
GYRO_6 = np.genfromtxt(FOLDER / "mislabelled_gyro.csv", delimiter=",", skip_header=1)[:, 5:]  # rad/s, of the motion


def tagged():
    """A log of two kinds of records, the gyroscope's in degrees per second."""
    lines = ["FMT,GYR,t,gx,gy,gz", "FMT,BAT,t,V", "UNIT,GYR,s,deg/s,deg/s,deg/s"]
    for t, w in zip(T, np.degrees(GYR), strict=True):
        lines += [f"GYR,{t:.3f},{w[0]:.7f},{w[1]:.7f},{w[2]:.7f}", f"BAT,{t:.3f},12.5"]
    return "\n".join(lines) + "\n"


def counts():
    """Whole numbers, and what one of them is, above the headers."""
    told = "Sensor;Block 3\nGyro LSB (deg/s);0.0175\n\n"
    given = np.round(np.degrees(GYR) / 0.0175).astype(int)
    return text({"time (s)": T, **vector("gyr_{}", given)}, ";", head=told)


RATES = {
    "B10, tagged.csv": ("tagged.csv", GYRO_6, RECORDS, 1e-5),
    "B10, raw_counts.gcsv": ("raw_counts.gcsv", GYRO_6, "", 1e-3),
    "B10, sibling: a log of records": (tagged(), GYR, RECORDS, 1e-6),
    "B10, sibling: counts": (counts(), GYR, r"LSB|0\.0175", 2e-4),
    "B11, x-axis (deg/s)": (text({"time": T, **vector("{}-axis (deg/s)", np.degrees(GYR))}), GYR, "", 1e-9),
    "B11, rad s^-1": (text({"time": T, **vector("w_RS_S_{} [rad s^-1]", GYR)}), GYR, "", 1e-9),
    "B11, sibling: °/s": (text({"Zeit (s)": T, **vector("{}-Achse [°/s]", np.degrees(GYR))}, ";"), GYR, "", 1e-9),
}

# what is tested


@pytest.mark.parametrize("name", CASES)
def test_cases(name, tmp_path):
    """By the command that their users type; what it says is taken as one line."""
    case = CASES[name]
    for file, content in case.files.items():
        written(content, tmp_path / file)
    places = [{word: folder / word for word in names} for folder, names in ((tmp_path, case.files), (FOLDER, STORED))]
    words = [(places[1] | places[0]).get(word, word) for word in case.arguments]
    result = nontwist("twist", *words, "--no-figure", "--json", "--out", tmp_path / "out", COLUMNS="1000")
    said = " ".join((result.stderr + result.stdout).split())
    if result.exit_code:
        assert result.exit_code in (2, 3), result.exception
        assert case.refusal, said
        assert re.search(case.refusal, said), said
        return
    found = json.loads(result.stdout)
    assert case.value is not None, said
    assert found["twist_angle"] == pytest.approx(case.value, abs=case.within)
    assert re.search(case.says, said), said
    if case.duration is not None:
        assert found.get("duration") == pytest.approx(case.duration, abs=1e-4)


@pytest.mark.parametrize("name", RATES)
def test_angular_velocities(name, tmp_path):
    content, truth, refusal, within = RATES[name]
    path = FOLDER / content
    if "\n" in content:
        path = tmp_path / "a.csv"
        written(content, path)
    if refusal:
        with pytest.raises(ValueError, match=refusal):
            read_rates(path)
        return
    found = read_rates(path)
    assert abs(found.rates - truth).max() < within
    assert np.ptp(found.time) == pytest.approx(0.02 * (len(truth) - 1), abs=1e-9)


def test_json_of_a_twist_of_few_samples_has_no_nan(tmp_path):
    """E3."""
    written(text({"time": T[:8], **quat("q{}", values=makers.WXYZ[:8])}), tmp_path / "a.csv")
    ended(0, "twist", tmp_path / "a.csv", "--no-figure", "--out", tmp_path / "o")
    told = ended(0, "info", "--json", tmp_path / "o.nc").stdout
    ended(0, "export", tmp_path / "o.nc", "--to", "json", "--out", tmp_path / "o.json")
    assert not re.search(r"\bNaN\b", told + (tmp_path / "o.json").read_text(encoding="utf-8"))


def test_the_kernels_that_a_caller_has_loaded_stay(tmp_path):
    """E4."""
    spiceypy = pytest.importorskip("spiceypy")
    makers.spice_kernels(tmp_path / "a.tm")
    spiceypy.furnsh(str(tmp_path / "leap.tls"))
    try:
        read_motion(tmp_path / "a.tm", rate=50)
        assert spiceypy.ktotal("ALL") == 1
        assert spiceypy.gdpool("DELTET/DELTA_T_A", 0, 1)[0] == 32.184
    finally:
        spiceypy.kclear()


def test_times_outside_of_a_run_without_an_end_are_told_in_words():
    """E7."""
    with pytest.raises(ValueError, match="outside of the run") as told:
        simulate(standard(np.diag([1.0, 2, 3])), t_start=1, times=[0.5, 2], material_angular_velocity=(1, 0, 0))
    assert "None" not in str(told.value)
