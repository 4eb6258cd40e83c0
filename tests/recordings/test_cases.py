"""Recordings that version 0.2.0 read wrongly, or refused without the remedy, and siblings of each.

Files of the cases lie in data/cases; a sibling is of another maker or format, has the same kind of fault, and a motion
whose twist is known.
"""

import io
import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import ended, nontwist
from nontwist import read_motion, simulate, standard
from nontwist.recordings.reading import read_rates

from . import makers
from .makers import EULER, GYR, N, Q, R, T, columns, made, quat, text, vector
from .test_truth import require_motion

pytestmark = pytest.mark.usefixtures("libraries_read_here")
FOLDER = makers.DATA / "cases"
STORED = {file.name for file in FOLDER.iterdir()}
PSI = 4.92139  # rad: the twist of the motion in most files of the cases, over 6 s


class Case(NamedTuple):
    """A command on a recording.

    Attributes
    ----------
    arguments : files and options of `nontwist twist`; the first file may be the second as well
    value : the total twist, rad; None where only a refusal is right
    refusal : pattern that the message of a refusal has, where one is permitted
    says : pattern of what is said about the reading, in the output or a warning
    duration : of the samples, s
    within : of the value, rad
    files : mapping of name to text; those of data/cases need none
    """

    arguments: tuple[str, ...]
    value: float | None = PSI
    refusal: str = ""
    says: str = ""
    duration: float | None = None
    within: float = 1e-5
    files: Mapping[str, str] = MappingProxyType({})


def case(line, **told):
    """A case by its command."""
    return Case(tuple(line.split()), **told)


# two bodies that move on their own; the twist of the joint is the last of its angles

T6 = np.arange(301) / 50


def arm(t):
    return Rotation.from_euler("XY", np.stack([0.5 * np.sin(1.3 * t), 0.4 * np.sin(0.9 * t + 1)], axis=1))


def hand(t):
    return arm(t) * Rotation.from_euler("YZ", np.stack([0.3 + 0.7 * np.sin(1.9 * t), 0.9 * np.sin(2.3 * t)], axis=1))


JOINT = 0.9 * np.sin(2.3 * T6[-1])


def scalar_first(attitudes):
    return np.round(np.roll(attitudes.as_quat(), 1, axis=1), 10)


OF_HAND, OF_ARM = scalar_first(hand(T6)), scalar_first(arm(T6))


def in_turn(ids):
    """Rows of the hand and of the arm in turn, told apart by the first column."""
    table = {"Device name": [one for _ in T6 for one in ids], "time": np.repeat(T6, 2)}
    return text(table | quat("q{}", values=np.stack([OF_HAND, OF_ARM], axis=1).reshape(-1, 4)), "\t")


# content of siblings

RAD, DPS = vector("gyr_{} (rad/s)", GYR), vector("gyr_{} (deg/s)", np.degrees(GYR))
PLAIN = quat("q{}")


KEPT = np.delete(np.arange(N), range(20, 25))
START_DAY = datetime(2026, 3, 31, 12, 59, 59, 500_000)
UTC_START = int(START_DAY.replace(tzinfo=UTC).timestamp()) - 7200  # two hours before that, s since 1970
DATES = [START_DAY + timedelta(milliseconds=20 * k) for k in range(N)]
LATE = [d + timedelta(hours=11) for d in DATES]  # into the next day
YPR = ("yaw", "pitch", "roll")
DATES_6 = [START_DAY + timedelta(milliseconds=20 * k) for k in range(301)]
MS = 20 * np.arange(N)
PAUSE = np.outer(np.maximum(T - 0.68, np.minimum(T - 0.5, 0)), [0, 0, 1.0])  # rad, at rest from 0.5 to 0.68 s


def lost(values, instead):
    """Quaternions of which five in a row are replaced."""
    values = values.copy()
    values[20:25] = instead
    return values


def clocked(header, times, values=makers.WXYZ, **dialect):
    return text({header: times, **quat("q{}", values=values)}, **dialect)


def twice(pattern, letters, values):
    """Columns of zeros before others with the same headers."""
    other = columns(f"{pattern}#", letters, 0 * values)
    return text({"time": T, **other, **columns(pattern, letters, values)}).replace("#", "")


def of_excel(content):
    """A storage file of OpenSim that a German spreadsheet has saved."""
    head, rows = content.split("endheader\n")
    return head + "endheader;;;\n" + rows.replace("\t", ";").replace(".", ",")


HOURS = r"(?i)(time zone|whole hours?|h apart)"


def two_files(one, other, value=JOINT, refusal=HOURS, within=1e-4, duration=None):
    """The hand relative to the arm, from two tables."""
    files = {"a.csv": one, "b.csv": other}
    return Case(("a.csv", "--relative-to", "b.csv"), value, refusal, "", duration, within, files)


BIPED, FORE_UPPER = "biped_names.bvh", "two_sensors_forearm.csv --relative-to two_sensors_upperarm.csv"
IDS = r"(?s)SensorId.*\b1\b.*\b2\b"
BACK = r"(?is)(back|midnight|wrap|anew|over|day|week|2\^?31|counter)"
GONE = r"(?i)(dropped|missing|left out|lost)"

CASES = {
    "A1": case("two_connections.bag"),
    "A2": case("interleaved.csv", value=-0.304461, refusal=IDS),
    "A2, same times": case("interleaved_same_time.csv", value=-0.304461, refusal=IDS, says="SensorId"),
    "A3": case("mislabelled_gyro.csv", says="gyroscope"),
    "A3, --scalar-first": case("mislabelled_gyro.csv --columns qx,qy,qz,qw --scalar-first"),
    "A3b": case("coremotion.csv --euler ZXY --angle-unit rad", says="gyroscope"),
    "A4": case(BIPED, value=None, refusal=r"(?s)Bip01.*Bip01 Spine.*Bip01 Head"),
    "A4, the spine": Case((BIPED, "--body", "Bip01 Spine")),
    "A4, the head": Case((BIPED, "--body", "Bip01 Head"), value=11.2046, within=1e-4),
    "A5": case("position_xyz_w.csv"),
    "A5, --normalize": case("position_xyz_w.csv --normalize"),
    "A6": case(FORE_UPPER, value=-0.954935),
    "A6, sibling: times of day": two_files(clocked("time", [f"{d:%H:%M:%S.%f}" for d in DATES_6], OF_HAND),
        clocked("time", [f"{d:%H:%M:%S.%f}" for d in DATES_6[50:]], OF_ARM[50:]), JOINT - 0.9 * np.sin(2.3 * T6[50]),
        "", 1e-5, 5),
    "A6, sibling: dates of one": two_files(clocked("time", T6, OF_HAND), clocked("time", DATES_6, OF_ARM), None,
        "the clocks cannot be aligned"),
    "B1, midnight": case("midnight.csv", refusal=BACK, duration=6),
    "B1, 2^31 µs": case("counter31.csv", refusal=BACK, duration=6),
    "B1, second of the day": case("second_of_day.csv", refusal=BACK, duration=6),
    "B2": case("tracker_missing.csv", duration=6, says=GONE, within=2e-3),
    "B3": case("nanoseconds.csv", duration=6),
    "B4, an hour": two_files(clocked("time", [d.isoformat() + "Z" for d in DATES_6], OF_HAND),
        clocked("time", [(d + timedelta(hours=1)).isoformat() for d in DATES_6], OF_ARM)),
    "B4, sibling: since 1970": two_files(clocked("timestamp", 1000 * UTC_START + 500 + 20 * np.arange(301), OF_HAND),
        clocked("Datum", [f"{d:%d.%m.%Y %H:%M:%S.%f}" for d in DATES_6], OF_ARM, sep=";")),
    "B4, sibling: the next day": two_files(clocked("time", DATES_6, OF_HAND),
        clocked("time", [d + timedelta(days=1) for d in DATES_6], OF_ARM), None, "24 hours apart"),
    "B5": case("emg33.csv", duration=6),
    # over all rows of the hand: the first row of the arm is 8 ms after that of the hand
    "B6": case("sparse.csv --body /hand --relative-to sparse.csv --relative-body /arm", value=-0.507723, within=2e-5),
    "B7": case("emoji_names.bvh", value=None, refusal="man:leg:a.*man:foot:b.*man:hand:c"),
    "B7, one": case("emoji_names.bvh --body man:foot:b", says="man:foot:b"),
    "B8": case("poses_n44.npy --rate 50", refusal=r"301.*4.*4", duration=6),
    "B8, poses": case("body_poses.npz", value=None, refusal=r"poses 0, poses 1, .*poses 51"),
    "B8, the root of the poses": Case(("body_poses.npz", "--body", "poses 0")),
    "B9, decimal commas": case("decimal_comma.bvh --body Chest", duration=6),
    "B9, endheader": case("endheader_commas.mot --columns rx,ry,rz --euler XYZ", value=np.radians(40), duration=0.2),
}  # fmt: skip

# siblings: of another maker or format, with the same kind of fault; what is said of them is a pattern

IN_TURN, HELD = in_turn(("hand", "arm")), lost(scalar_first(R), scalar_first(R)[19])
CLOCKS = {  # headers and times without a warning
    "time_ms": (65_000 + MS) % 2**16, "time (s)": (604_799.5 + T) % 604_800, "seconds": (59.5 + T) % 60,
    "time": [f"{d:%I:%M:%S.%f}" for d in DATES], "time_us": (2.0**32 - 500_000 + 1000 * MS) % 2**32, "elapsed_s": T,
    "Time": [f"50:{12.3 + t:05.2f}" for t in T], "Elapsed_ms": MS,
}  # fmt: skip
BIAS, DEGREES = 0 * GYR + [0.01, 0.02, 0.07], R.as_rotvec(degrees=True)
SIBLINGS = {
    **{f"B1 and B11, {header}": made(clocked(header, times, sep=";")) for header, times in CLOCKS.items()},
    "A2, the name as the body": made(IN_TURN, truth=hand(T6), times=T6, body="hand"),
    "A2, no names": made(re.sub("hand\t|arm\t|Device name\t", "", IN_TURN), says="in turn", truth=None),
    "A2, parts of one motion": made({"segment": ["arm"] * 30 + ["leg"] * 30, **PLAIN}),
    "A3, a gyroscope with other axes": made({**PLAIN, **vector("gyr_{} (rad/s)", GYR[:, [1, 2, 0]])}),
    "A3, headers alone": made(quat("q{}", values=Q), columns=["qw", "qx", "qy", "qz"], scalar_first=False,
        says="another order"),
    "A3, the gyroscope of another": made({**quat("a1 q{}"), **quat("a10 q{}", values=makers.WXYZ * [1, -1, -1, -1]),
        **vector("a10 gyr_{} (rad/s)", -makers.SPACE)}, body="a1"),
    "A3, degrees as radians": made({**columns("rotvec_{}", "xyz", R.as_rotvec(degrees=True)), **RAD},
        rotation_vector=True, says="gyroscope"),
    "A3b, a unit": made({**columns("{}", YPR, EULER), **DPS}, euler="ZYX", angle_unit="deg",
        truth=Rotation.from_euler("ZYX", EULER, degrees=True), says="rad: yaw, pitch, roll.*wrong"),
    "B2, -9999": made(quat("Quat_{}", "WXYZ", lost(scalar_first(R), -9999.0)), says=GONE, missing=5),
    "B2, a row that is held": made(quat("q{}", values=HELD), says="5 rows, which repeat .* is line 22", missing=5),
    "B2, identities at the start": made(quat("q{}", values=np.where(T[:, None] < 0.1, [1.0, 0, 0, 0], makers.WXYZ)),
        says="missing: 5 rows", missing=5),
    "B2, a rest at the identity": made(quat("q{}", values=scalar_first(Rotation.from_rotvec(PAUSE))),
        truth=Rotation.from_rotvec(PAUSE)),
    "B2, angles": made(columns("{} (deg)", YPR, lost(np.degrees(EULER), -9999.0)), missing=5, euler="ZYX"),
    "B3, date and time of day": made(text({"Date": [f"{d:%d.%m.%Y}" for d in LATE],
        "Time": [f"{d:%H:%M:%S,%f}" for d in LATE], **PLAIN}, ";", decimal=",")),
    "B3, seconds and ms": made(text({"time_s": makers.START + MS // 1000, "time_ms": MS % 1000, **PLAIN}, "\t")),
    "B9, a spreadsheet": made(of_excel(makers.mot(degrees=True)), "a.mot", columns=[f"free_rot_{x}" for x in "xyz"],
        euler="XYZ"),
    "B9, Quaternions 0()": made(quat("Quaternions {}()", "0123"), scalar_first=True),
    "B9, Q0 Qx Qy Qz of tools": made(quat("Tool1 Q{}", "0xyz") | quat("Tool2 Q{}", "0xyz", 0 * Q + [1, 0, 0, 0]),
        body="Tool1"),
    "B11, ticks of .NET": made(clocked("Timestamp", 639_105_768_000_000_000 + 10_000 * MS), says="ticks of .NET"),
    "B11, years, months, days": made(text({"Year": [2026] * N, "Month": [3] * N, "Day": [31] * N, "Hour": [12] * N,
        "Minute": [59] * N, "Second": 58.5 + T, **PLAIN}), says="Year Month Day Hour Minute Second"),
    "B11, ms by the gyroscope": made(text({"time": MS // 20, **PLAIN, **vector("gyr_{} (rad/s)", 20 * GYR)}),
        times=T / 20, says="^(?!.*no reading).*in ms, by the gyroscope"),
    "C1, a header twice": made(twice("{} (deg)", YPR, np.degrees(EULER)), euler="ZYX",
        columns=[f"{name} (deg).1" for name in YPR]),
    "C1, no unit": made(vector("r{}", np.outer(T, [0, 0, 57.3])), rotation_vector=True,
        truth=Rotation.from_rotvec(np.outer(T, [0, 0, 57.3])), says="67.61 rad, .*angle_unit"),
    "C2, a matrix beside": made(columns("{} (deg)", YPR, np.degrees(EULER)) | makers.matrix("r{}{}"), euler="XYZ",
        truth=Rotation.from_euler("XYZ", EULER[:, ::-1]), says="ZYX about moving axes.*wrong"),
    "EuRoC, a bias": made({**PLAIN, **vector("b_w_RS_S_{} [rad s^-1]", BIAS)}, says="^(?!.*no reading)"),
    "RepoIMU, names above": made(text({"#": T, **quat("{}", "WXYZ"), **vector("{}#", GYR, "XYZ")}, ";",
        head="Time (s);Vicon Orientation;;;;IMU Gyroscope;;\n").replace("#", ""), says="agreement with the gyroscope"),
    "Vicon, segments": made(text({"Frame": range(N), "Sub Frame": [0] * N, **vector("R{}", DEGREES, "XYZ"),
        **vector("R{}#", -DEGREES, "XYZ")}, head="Segments,,,,,,,\n100,,,,,,,\n,,a:arm,,,a:leg,,\n",
        below=",,deg,deg,deg,deg,deg,deg\n").replace("#", ""), rotation_vector=True, body="a:arm", rate=50),
    "WitMotion, a temperature": made(text({"Time (s)": T, "T(°)": [25.5] * N, **PLAIN})),
    "ArduPilot, a temperature": made(text({"timestamp": T, "T": [25.5] * N, **PLAIN})),
    "STK": made(text({"t": T, **PLAIN}, " ", head="BEGIN Attitude\nAttitudeTimeQuaternions\n", headers=False)
        + "\nEND Attitude\n", scalar_first=True),
    "CCSDS": made(makers.aem("ICRF"), says="REF_FRAME_A = ICRF"),
    "CCSDS, the other order": made(makers.aem("ICRF"), scalar_first=False, truth=Rotation.from_quat(makers.WXYZ),
        says="the file states another order"),
    "MATLAB, names of months": made(clocked("time", [f"{d:%d-%b-%Y %H:%M:%S.%f}" for d in DATES])),
    "CCSDS, days of the year": made(clocked("time", [f"{d:%Y-%jT%H:%M:%S.%f}" for d in DATES])),
    "OpenSim, forces of two plates": made(text({"time": T, **vector("r{}", R.as_euler("XYZ", degrees=True)), "f": T,
        "f#": T}, "\t", head="inDegrees=yes\nendheader\n").replace("#", ""), "a.mot", columns=["rx", "ry", "rz"],
        euler="XYZ"),
    **{f"R, rows of {word} first": made(clocked("time", T[20:], lost(makers.WXYZ, np.nan)[20:]).replace("nan", word),
        truth=R[20:], times=T[20:], missing=5) for word in ("NA", "null")},
    "VQF, a sampling rate": made(partial(makers.npz, arrays={"quat": makers.WXYZ, "sampling_rate": 50.0}), "a.npz",
        scalar_first=True),
    "OpenSim, degrees said to be rad": made(columns("{} (rad)", YPR, np.degrees(EULER)), euler="ZYX",
        truth=Rotation.from_euler("ZYX", np.degrees(EULER)), says="152.4 rad, more than a turn"),
    **{f"MATLAB, arrays of other lengths beside {name}": made(partial(makers.mat, arrays={"t": T, "t0": 0.0,
        "EMG": np.ones(70), **arrays}), "a.mat", scalar_first=True)
       for name, arrays in {"columns": quat("q{}", "0123"), "a quaternion": {"q": makers.WXYZ}}.items()},
    "MATLAB, samples in columns": made(partial(makers.mat, arrays={"t": T, "orient": makers.WXYZ.T, "gyr": GYR.T,
        "P": np.repeat(np.eye(4)[:, :, None], N, 2)}), "a.mat", body="orient", says="agreement with the gyroscope"),
    "C3, lost packets": made(text({"PacketCounter": KEPT, **quat("q{}", values=makers.WXYZ[KEPT])}), truth=R[KEPT],
        times=None, says="numbers 5 samples .* before line 22; rate="),
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


TABBED = text({"t": T, **vector("G{}_C", np.degrees(GYR))}, "\t", below="s" + "\tdeg/s" * 3 + "\n")
RATES = {
    "B10, tagged.csv": ("tagged.csv", GYRO_6, RECORDS, 1e-5),
    "B10, raw_counts.gcsv": ("raw_counts.gcsv", GYRO_6, "", 1e-3),
    "B10, sibling: a log of records": (tagged(), GYR, RECORDS, 1e-6),
    "B10, sibling: counts": (counts(), GYR, r"LSB|0\.0175", 2e-4),
    "B11, x-axis (deg/s)": (text({"time": T, **vector("{}-axis (deg/s)", np.degrees(GYR))}), GYR, "", 1e-9),
    "B11, rad s^-1": (text({"time": T, **vector("w_RS_S_{} [rad s^-1]", GYR)}), GYR, "", 1e-9),
    "in radians/s": (text({"time": T, **vector("{} (in radians/s)", GYR)}), GYR, "", 1e-9),
    "EuRoC, a bias": (text({"time": T, **vector("b_w_RS_S_{} [rad s^-1]", BIAS)}), None, "no columns contain", 0),
    "Shimmer, tabs at the ends": (TABBED.replace("\n", "\t\n"), GYR, "", 1e-9),
    "units below": (
        text({"time": T, **vector("g{}", np.degrees(GYR))}, head="Trial 7\n", below="(s),(deg/s),(deg/s),(deg/s)\n"),
        GYR,
        "",
        1e-9,
    ),
    "B11, sibling: °/s": (text({"Zeit (s)": T, **vector("{}-Achse [°/s]", np.degrees(GYR))}, ";"), GYR, "", 1e-9),
}

# what is tested


@pytest.mark.parametrize("name", CASES)
def test_cases(name, tmp_path):
    """By the command that their users type; what it says is taken as one line."""
    case = CASES[name]
    for file, content in case.files.items():
        (tmp_path / file).write_text(content, encoding="utf-8")
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


@pytest.mark.parametrize("name", SIBLINGS)
def test_siblings(name, tmp_path):
    require_motion(SIBLINGS[name], tmp_path)


@pytest.mark.parametrize(
    ("header", "since"), [("DateTime", 25_569), ("datenum", 719_529), ("Julian date", 2_440_587.5)]
)
def test_origin_of_days(header, since):
    """B11."""
    content = clocked(header, [f"{since + 20_543.5 + t / 86_400:.12f}" for t in T])
    found = read_motion(io.StringIO(content))
    assert found.time.values == pytest.approx(T, abs=5e-5)
    assert found.attrs["start"] == pytest.approx(20_543.5 * 86_400, rel=0, abs=1e-3)


@pytest.mark.parametrize("name", RATES)
def test_angular_velocities(name, tmp_path):
    content, truth, refusal, within = RATES[name]
    path = FOLDER / content
    if "\n" in content:
        path = tmp_path / "a.csv"
        path.write_text(content, encoding="utf-8")
    if refusal:
        with pytest.raises(ValueError, match=refusal):
            read_rates(path)
        return
    found = read_rates(path)
    assert abs(found.rates - truth).max() < within
    assert np.ptp(found.time) == pytest.approx(0.02 * (len(truth) - 1), abs=1e-9)


def test_json_without_nan(tmp_path):
    """E3."""
    made(text({"time": T[:8], **quat("q{}", values=makers.WXYZ[:8])})).write(tmp_path)
    ended(0, "twist", tmp_path / "a.csv", "--no-figure", "--out", tmp_path / "o")
    told = ended(0, "info", "--json", tmp_path / "o.nc").stdout
    ended(0, "export", tmp_path / "o.nc", "--to", "json", "--out", tmp_path / "o.json")
    assert not re.search(r"\bNaN\b", told + (tmp_path / "o.json").read_text(encoding="utf-8"))


def test_spice_kernels_stay(tmp_path):
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


def test_endless_run_and_times_outside():
    """E7."""
    with pytest.raises(ValueError, match="outside of the run") as told:
        simulate(standard(np.diag([1.0, 2, 3])), t_start=1, times=[0.5, 2], material_angular_velocity=(1, 0, 0))
    assert "None" not in str(told.value)
