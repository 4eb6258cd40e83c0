"""What is read of recordings with known truth: the truth, and what 0.2.0 read of them, bit for bit (`test_same`).

`MOTIONS` holds one for each row of the tables of docs/howto/recordings.md and for each variant of text that it names,
`RATES` those of angular velocities.
"""

import hashlib
import json
import re
import warnings
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nontwist import read_motion
from nontwist.recordings.reading import read_rates
from refusals import RENEW

from . import makers
from .makers import GYR, MATRICES, START, WXYZ, N, Q, R, T, columns, copied, made, mt_manager, quat, text, vector

pytestmark = pytest.mark.usefixtures("libraries_read_here")

RECORDED = makers.DATA / "recordings_0.2.0.json"
MS, US, NS = (np.array([20 * scale * k for k in range(N)]) for scale in (1, 1000, 1_000_000))
DEGREES, ROTVEC, DPS = np.degrees(makers.EULER), R.as_rotvec(), np.degrees(GYR)
YPR = ("yaw", "pitch", "roll")
PLAIN = quat("q{}")
INVERSE = R.inv().as_quat()[:, [3, 0, 1, 2]]
TARED = R[0].inv() * R
STILL = np.tile([0.0, 0, 0, 1], (N, 1))
TWO = {"fore arm": Q, "upper": STILL}
GYROSCOPE, ACCELEROMETER = vector("Gyr_{} (rad/s)", GYR, "XYZ"), vector("Acc_{}", makers.ACC, "XYZ")

# makers, as the page names them

MT = partial(made, file="MT_0300-000.txt", within=3e-6)
DOT = {"head": "sep=,\nDeviceTag:,DOT 1\nFirmwareVersion:,2.0.0\n\n"}
PX4 = {"timestamp": 12_345_678 + US, **columns("{}speed", YPR[::-1], GYR), **quat("q[{}]", "0123")}
LOGGED = {"time": START * 10**9 + NS, "seconds_elapsed": T + 0.07}  # by Sensor Logger
SENSOR_LOGGER = {**LOGGED, **quat("q{}", "zyxw", Q[:, [2, 1, 0, 3]]), **columns("{}", YPR, makers.EULER)}
SHIMMER = {
    "Shimmer_8A_Timestamp_Unix_CAL": START * 1000 + MS,
    **quat("Shimmer_8A_Quat_Madge_9DOF_{}_CAL", "WXYZ"),
}
TUM = {"timestamp": START + T, **vector("t{}", GYR), **quat("q{}", "xyzw", Q)}
EUROC = {"#timestamp [ns]": START * 10**9 + NS, **vector(" p_RS_R_{} [m]", GYR), **quat(" q_RS_{} []")}
FREE = {"columns": [f"free_rot_{x}" for x in "xyz"], "euler": "XYZ", "exact": False}
CK = {"rate": 50, "within": 2e-6, "exact": False}
COUNTED = {"PacketCounter": range(N), "SampleTimeFine": 4_000_000_000 + US}
DOT_ANGLES = {"euler": "ZYX", "angle_unit": "deg", "time_unit": "us", "exact": False}

MAKERS = {
    "Xsens MTi, quaternions": MT(mt_manager("\t", ("Acc", "Gyr", "Quat")), rate=50),
    "Xsens MTi, matrices": MT(mt_manager(";", ("Gyr", "Mat")), rate=50),
    "Xsens MTi, angles": MT(mt_manager(",", ("Acc", "Euler")), rate=50, euler="ZYX", angle_unit="deg", exact=False),
    "Xsens MTi, all": MT(mt_manager(" ", ("Acc", "Gyr", "Quat", "Euler", "Mat")), rate=50, normalize=True),
    "Xsens MTi, ticks": made(text({"SampleTimeFine": 9000 + MS * 10, **quat("Quat_q{}", "0123")}), time_unit="1e-4"),
    "Xsens DOT": made(text({**COUNTED, **quat("Quat_{}", "WXYZ")}, **DOT), time_unit="us"),
    "Xsens DOT, angles": made(text({**COUNTED, **vector("Euler_{}", DEGREES[:, ::-1], "XYZ")}, **DOT), **DOT_ANGLES),
    "Xsens MVN, segment": made(makers.mvnx(), "a.mvnx", body="LeftHand"),
    "Xsens MVN, sensor": made(makers.mvnx(), "a.mvnx", body="sensor LeftHand"),
    "APDM": made(makers.apdm(), body="Upper"),
    "x-io NGIMU": made(text({"Time (s)": T, **quat("{}", "WXYZ", INVERSE)}), inverse=True),
    "x-io x-IMU3": made(text({"Timestamp (us)": 9_000_000 + US, **quat("{}", "WXYZ")})),
    "PX4": made(text(PX4), scalar_first=True, time_unit="us"),
    "MicroStrain": made(quat("estOrientQuaternion_{}", "0123"), scalar_first=True),
    "EuRoC": made(text(EUROC)),
    "TUM": made("# ground truth\n# " + text(TUM, " "), "a.txt"),
    "Sensor Logger": made(text(SENSOR_LOGGER), "Orientation.csv"),
    "phyphox": made(text({'"Time (s)"': T, **quat('"Attitude {}"')})),
    "Android": made(text({"timestamp": START * 1000 + MS, **PLAIN})),
    "Apple": made(text({"motionTimestamp_sinceReboot(s)": T + 5000, **quat("motionQuaternion{}(R)", "XYZW", Q)})),
    "Shimmer": made(text(SHIMMER, "\t", below="ms" + "\tno_units" * 4 + "\n")),
    "OptiTrack Motive": made(makers.motive({"arm": Q})),
    "OptiTrack Motive, two bodies": made(makers.motive(TWO), body="fore arm"),
    "Qualisys": made(makers.qualisys({"fore arm": R}), "a.tsv"),
    "Qualisys, two bodies": made(makers.qualisys({"fore arm": R, "upper": R.inv()}), "a.tsv", body="fore arm"),
    "Qualisys, angles": made(makers.qualisys({"fore arm": R}), "a.tsv", euler="XYZ", angle_unit="deg", exact=False),
    "OpenSense": made(makers.sto(), "a.sto", body="humerus_imu"),
    "OpenSim, a free joint": made(makers.mot(degrees=True), "a.mot", **FREE),
    "OpenSim, in rad": made(makers.mot(degrees=False), "a.mot", **FREE),
    "C3D": made(makers.c3d, "a.c3d", body="r_larm_4X4", within=1e-6),
    "C3D, normalized": made(makers.c3d, "a.c3d", body="r_larm_4X4", normalize=True, within=1e-6, exact=False),
    "BVH": made(makers.bvh(), "a.bvh", body="Arm", exact=False),
    "SPICE CK": made(makers.spice_kernels, "a.tm", body="-9000", **CK),
    "SPICE CK, no rates": made(partial(makers.spice_kernels, spinning=False), "a.tm", **CK),
}
BAGS = {
    "ROS 1": ("a.bag", "", partial(makers.ros, version=1)),
    "ROS 2, folder": ("a", "", partial(makers.ros, version=2)),
    "ROS 2, .db3": ("a", "a/a.db3", partial(makers.ros, version=2)),
    "ROS 2, .mcap": ("a", "a/a.mcap", partial(makers.ros, version=2, storage="MCAP")),
}
TOPICS_OF = {"ROS 1": ("/imu", "/pose", "/odometry", "/tf:base"), "ROS 2, folder": ("/imu", "/tf:base")}
MAKERS |= {
    f"{name}, {body}": made(write, file, inner=inner, body=body, times=START + T)
    for name, (file, inner, write) in BAGS.items()
    for body in TOPICS_OF.get(name, ("/odometry",))
}

# formats

TABLE = np.column_stack([T, WXYZ])
ARRAYS = {"attitude": MATRICES, "time": T, "gyr": np.round(GYR, 12), "acc": np.round(makers.ACC, 12)}
STRUCTURE = {"data": {"time": T, "q": Q}, "note": "by hand"}
SINGLE = {"scalar_first": True, "within": 2e-7, "times": T.astype(np.float32)}


def array(file, arrays, **options):
    """A file of arrays, in NumPy's format or MATLAB's."""
    write = {"npy": makers.npy, "npz": makers.npz, "mat": makers.mat, "7.3": makers.mat73}[file]
    return made(partial(write, arrays=arrays), f"a.{file}".replace("7.3", "mat"), **options)


FORMATS = {
    **{f".{one}": made(PLAIN, f"a.{one}") for one in ("csv", "tsv", "txt", "dat", "log", "asc", "CSV")},
    ".npy, quaternions": array("npy", WXYZ, scalar_first=True, rate=50),
    ".npy, matrices": array("npy", MATRICES, times=None),
    ".npy, columns": array("npy", TABLE, scalar_first=True),
    ".npy, columns of 32 bits": array("npy", TABLE.astype(np.float32), **SINGLE),
    ".npy, a structured array": array("npy", np.rec.fromarrays(TABLE.T, names="time,qw,qx,qy,qz")),
    ".npz, matrices": array("npz", ARRAYS),
    ".npz, two arrays": array("npz", {"t": T, **TWO}, body="fore arm", scalar_first=False),
    ".mat, matrices": array("mat", ARRAYS),
    ".mat, a structure": array("mat", STRUCTURE, scalar_first=False),
    ".mat, columns in a structure": array("mat", {"imu": PLAIN}, rate=50),
    ".mat, pages": array("mat", {"R": np.moveaxis(MATRICES, 0, 2)}, rate=50),
    ".mat, version 7.3": array("7.3", {"quat": WXYZ, "time": T}, scalar_first=True),
    ".nc, a run of 0.1.0": made(makers.old_run, "a.nc", truth=None, times=None),
    ".nc, a steady run": made(
        makers.steady_run, "b.nc", truth=Rotation.from_rotvec(np.outer(T, [0, 0, 2])), within=1e-9, exact=False
    ),
}

# text

DIALECTS = {
    "commas": {},
    "semicolons": {"sep": ";"},
    "tabs": {"sep": "\t"},
    "blanks": {"sep": " "},
    "decimal commas, semicolons": {"sep": ";", "decimal": ","},
    "decimal commas, tabs": {"sep": "\t", "decimal": ","},
    "decimal commas in quotes": {"decimal": ","},
    "comments above": {"head": "# one, with a comma\n// two\n% three\n\n"},
    "comments between": {"between": ["# paused, and resumed, by hand, at noon", "// on again", "% and again"]},
    "lines before the headers": {"head": "Device;Arm 7\nOperator: A. B.\n\nRate: 50\n"},
    "a line of units": {"below": "s,-,-,-,-\n"},
    "headers in the last comment": {"head": "# made by hand\n# time,qw,qx,qy,qz\n", "headers": False},
    "headers in a comment, blanks": {"sep": " ", "head": "# time qw qx qy qz\n", "headers": False},
    "blank lines": {"between": ["", "  ", ""]},
    "rows without numbers": {"between": ["0.19,,,,"]},
}
VARIANTS = {name: made(text({"time": T, **PLAIN}, **dialect)) for name, dialect in DIALECTS.items()}
BARE, LOST = partial(text, headers=False), {"truth": None, "times": None}
NINE = {f"c{k}": MATRICES[:, k // 3, k % 3] for k in range(9)}
VARIANTS["rows without numbers"] = made(text({"time": T, **PLAIN}, **DIALECTS["rows without numbers"]), **LOST)
VARIANTS |= {
    "lines that end in CR LF": made(text({"time": T, **PLAIN}).replace("\n", "\r\n")),
    "a last line without end": made(text({"time": T, **PLAIN}).rstrip()),
    "no headers, time": made(BARE({"time": T, **PLAIN}), scalar_first=True),
    "no headers, quaternions": made(BARE(PLAIN), scalar_first=True, rate=50),
    "no headers, matrices": made(BARE(NINE), rate=50),
    "no headers, numbers": made(BARE({"n": STILL[:, 0], "t": T, **PLAIN}), columns=[*"23456"], scalar_first=True),
}
for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-be", "cp1252"):
    content = "\ufeff" * (encoding == "utf-16-be") + text({"time": T, **columns("{} (°)", YPR, DEGREES)})
    VARIANTS[f"encoding {encoding}"] = made(content, encoding=encoding, euler="ZYX", exact=False)

COLUMNS = {  # the columns beside the time, and how they are read
    "qw qx qy qz": (PLAIN, {}),
    "qx qy qz qw": (quat("q{}", "xyzw", Q), {}),
    "W X Y Z": (quat("{}", "WXYZ"), {}),
    "Quat_W": (quat("Quat_{}", "WXYZ"), {}),
    "Quat_W_CAL": (quat("Quat_{}_CAL", "WXYZ"), {}),
    "orientation/w": (quat("/imu/orientation/{}"), {}),
    "qr qi qj qk": (quat("q{}", "rijk"), {}),
    "q_real": (quat("q_{}", ("real", "i", "j", "k")), {}),
    "q_s": (quat("q_{}", "sxyz"), {}),
    "Scalar": (quat("Orientation/{}", ("Scalar", "X", "Y", "Z")), {}),
    "Quat_q0": (quat("Quat_q{}", "0123"), {}),
    "x y z beside": ({"x": T, "y": T, "z": T, **PLAIN}, {}),
    "q0, first": (quat("q{}", "0123"), {"scalar_first": True}),
    "q0, last": (quat("q{}", "0123", Q), {"scalar_first": False}),
    "q1, first": (quat("q{}", "1234"), {"scalar_first": True}),
    "q1, last": (quat("quat_{}", "1234", Q), {"scalar_first": False}),
    "q0, identity first": (quat("q{}", "0123", TARED.as_quat()[:, [3, 0, 1, 2]] + 0.0), {"truth": TARED}),
    "q1, identity first": (quat("q{}", "1234", TARED.as_quat() + 0.0), {"truth": TARED}),
    "q0, by the gyroscope": (quat("q{}", "0123") | GYROSCOPE, {}),
    "q1, by the gyroscope": (quat("q{}", "1234", Q) | GYROSCOPE, {}),
    "r11": (makers.matrix("r{}{}"), {}),
    "m00": (makers.matrix("m{}{}", 0), {}),
    "Mat[1][1]": (makers.matrix("Mat[{}][{}]"), {}),
    "Rot[0]": ({f"Rot[{k}]": MATRICES[:, k % 3, k // 3] for k in range(9)}, {}),
    "directors": ({f"d{i + 1}_{x}": MATRICES[:, k, i] for i in range(3) for k, x in enumerate("xyz")}, {}),
    "gyroscope beside": (PLAIN | GYROSCOPE, {}),
    "accelerometer beside": (PLAIN | ACCELEROMETER, {}),
    "--columns": (quat("{}", "abcd"), {"columns": ["time", *"abcd"], "scalar_first": True}),
    "--columns, matrix": (NINE, {"columns": list(NINE), "time_column": "time"}),
    "--body": (quat("Fore_{}", values=INVERSE) | quat("Upper_{}"), {"body": "upper"}),
    "--inverse": (quat("q{}", values=INVERSE), {"inverse": True}),
    "--inverse, gyroscope": (quat("q{}", values=INVERSE) | GYROSCOPE, {"inverse": True}),
    "--inverse, matrix": (makers.matrix("r{}{}", values=MATRICES.swapaxes(1, 2)), {"inverse": True}),
    "rounded": (quat("q{}", values=[[f"{x:.3f}" for x in q] for q in WXYZ]), {"normalize": True, "within": 2e-3}),
    "integers": (quat("q{}", values=np.round(WXYZ * 2**14).astype(int)), {"normalize": True, "within": 2e-4}),
}
TURNED = {
    "roll pitch yaw (deg)": (columns("{} (deg)", YPR, DEGREES), {"euler": "ZYX"}),
    "Euler_X [rad]": (vector("Euler_{} [rad]", makers.EULER[:, ::-1], "XYZ"), {"euler": "ZYX"}),
    "heading_deg": (columns("{}_deg", ("heading", "pitch", "roll"), DEGREES), {"euler": "ZYX"}),
    "fixed axes": (columns("{}", YPR, R.as_euler("zyx")), {"euler": "zyx", "angle_unit": "rad"}),
    "ZXZ": (columns("{} (rad)", "abc", R.as_euler("ZXZ")), {"euler": "ZXZ", "columns": [f"{x} (rad)" for x in "abc"]}),
    "rotation vector": (vector("rotvec_{}", ROTVEC), {"rotation_vector": True}),
    "rx ry rz, deg": (vector("r{}", np.degrees(ROTVEC)), {"rotation_vector": True, "angle_unit": "deg"}),
    "rounded matrix": (makers.matrix("r{}{}", values=np.round(MATRICES, 2)), {"normalize": True, "within": 1e-2}),
}
VARIANTS |= {f"columns {name}": made(table, **options) for name, (table, options) in COLUMNS.items()}
VARIANTS |= {f"columns {name}": made(table, exact=False, **options) for name, (table, options) in TURNED.items()}

DATES = [datetime(2026, 3, 31, 12, 0, 0, 500_000) + timedelta(milliseconds=20 * k) for k in range(N)]
TIMES = {
    "ISO": ("time", [d.isoformat() for d in DATES], {}),
    "ISO, UTC": ("Timestamp", [d.isoformat() + "Z" for d in DATES], {}),
    "y/m/d": ("DateTime", [f"{d:%Y/%m/%d %H:%M:%S.%f}" for d in DATES], {}),
    "d.m.y": ("Datum", [f"{d:%d.%m.%Y %H:%M:%S.%f}" for d in DATES], {}),
    "d.m.y, decimal comma": ("Datum", [f'"{d:%d.%m.%Y %H:%M:%S,%f}"' for d in DATES], {}),
    "m/d/y": ("Date", [f"{d:%m/%d/%Y %H:%M:%S.%f}" for d in DATES], {}),
    "m/d/y, PM": ("Date", [f"{d:%m/%d/%Y %I:%M:%S.%f} PM" for d in DATES], {}),
    "d/m/y": ("Date", [f"{d:%d/%m/%Y %H:%M:%S.%f}" for d in DATES], {}),
    "time of day": ("time", [f"{d:%H:%M:%S.%f}" for d in DATES], {}),
    "time of day, AM": ("time", [f"{d:%I:%M:%S.%f} AM" for d in DATES], {}),
    "since 1970, s": ("epoch", START + T, {}),
    "since 1970, ms": ("unix_timestamp", START * 10**3 + MS, {}),
    "since 1970, us": ("timestamp", START * 10**6 + US, {}),
    "since 1970, ns": ("timestamp", START * 10**9 + NS, {}),
    "ms": ("time_ms", MS, {}),
    "us": ("timestamp_us", US, {}),
    "ns": ("t [ns]", NS, {}),
    "min": ("time [min]", [f"{t / 60:.14f}" for t in T], {}),
    "--time-unit ms": ("time", MS, {"time_unit": "ms"}),
    "--time-unit 1e-4": ("time", MS * 10, {"time_unit": "1e-4"}),
    "ticks of 32 bits": ("SampleTimeFine", (US + 2**32 - 500_000) % 2**32, {"time_unit": "us"}),
    "in brackets": ("Zeit (s)", T, {}),
    "--time-column": ("when", T, {"time_column": "when"}),
    "samples": ("sample", range(N), {"rate": 50}),
    "packets": ("PacketCounter", 51400 + np.arange(N), {"rate": 50}),
    "packets of 16 bits": ("PacketCounter", (65530 + np.arange(N)) % 2**16, {"rate": 50}),
    "rows": ("note", ["x"] * N, {"rate": 50}),
    "rounded": ("time", [f"{t:.1f}" for t in T], {"rate": 50}),
}
VARIANTS |= {f"time {name}": made(text({header: time, **PLAIN}), **how) for name, (header, time, how) in TIMES.items()}

# files that other programs wrote

K = np.arange(12)
STEPS = np.stack([0.3 + 0.04 * K, 0.5 * np.sin(0.18 * K) - 0.2, 0.4 - 0.06 * K], axis=1)
BONES = [np.stack([0.7 * np.sin(0.4 * K + j), 0.2 * j - 0.05 * K, 0.3 + 0.1 * K], axis=1) for j in range(3)]
UPPER, FORE, HAND = map(Rotation.from_rotvec, BONES)
OPENSIM = {"truth": Rotation.from_euler("XYZ", STEPS), "times": K / 50, "within": 1e-13}
BVHIO = {"times": K / 50, "within": 1e-6, "exact": False}
FILES = makers.DATA / "readers"
OTHERS = {
    "opensim.sto": made(copied(FILES / "opensim.sto"), "a.sto", **OPENSIM),
    "opensim.mot": made(copied(FILES / "opensim.mot"), "a.mot", **OPENSIM, **FREE),
    "bvhio.bvh, upper": made(copied(FILES / "bvhio.bvh"), "a.bvh", body="upper", truth=UPPER, **BVHIO),
    "bvhio.bvh, fore": made(copied(FILES / "bvhio.bvh"), "a.bvh", body="fore", truth=UPPER * FORE, **BVHIO),
    "bvhio.bvh, hand": made(copied(FILES / "bvhio.bvh"), "a.bvh", body="hand", truth=UPPER * FORE * HAND, **BVHIO),
    "imu, quaternion.csv": made(copied(makers.ROOT / "examples/imu/quaternion.csv"), inverse=True, **LOST),
}
MOTIONS = MAKERS | FORMATS | VARIANTS | OTHERS

# angular velocities

SPEED = 40 + 10 * np.sin(T)  # of a rotor, rad/s
RAD = vector("g{} (rad/s)", GYR)
PHYPHOX = {'"Time (s)"': T, **vector('"Gyroscope {} (rad/s)"', GYR), '"Absolute (rad/s)"': np.linalg.norm(GYR, axis=1)}
GYRO = partial(made, truth=GYR, within=2e-10)
STEADY = {"truth": np.tile([0.0, 0, 2], (N, 1)), "within": 1e-9, "exact": False}
RATES = {
    "gx (rad/s)": GYRO(RAD),
    "gx, --unit": GYRO(vector("g{}", GYR), unit="rad/s"),
    "gyr_x_dps": GYRO(vector("gyr_{}_dps", DPS)),
    "gyr_x (deg/s), acc_x": GYRO(vector("gyr_{} (deg/s)", DPS) | vector("acc_{}", makers.ACC)),
    "wx [rad/s]": GYRO(vector("w{} [rad/s]", GYR)),
    "wx (mrad/s)": GYRO(vector("w{} (mrad/s)", 1e3 * GYR)),
    "wx (rpm)": GYRO(vector("w{} (rpm)", GYR * 30 / np.pi)),
    "Gyroscope x, phyphox": GYRO(text(PHYPHOX)),
    "Gyroscope X (deg/s)": GYRO(vector("Gyroscope {} (deg/s)", DPS, "XYZ")),
    "rotationRateX(rad/s)": GYRO(vector("rotationRate{}(rad/s)", GYR, "XYZ")),
    "rotationRateX": GYRO(vector("rotationRate{}", DPS, "XYZ"), unit="deg/s"),
    "angular_velocity.x": GYRO(vector("angular_velocity.{}", GYR), unit="rad/s"),
    "Sensor Logger": GYRO(text({**LOGGED, **vector("{}", GYR)}), columns=["time", *"xyz"], unit="rad/s"),
    "MT Manager": GYRO(mt_manager("\t", ("Acc", "Gyr")), rate=50, unit="rad/s", within=1e-6),
    "APDM": GYRO(makers.apdm(), body="Upper"),
    "decimal commas": GYRO(text({"t (s)": T, **vector("gyr_{} [deg/s]", DPS)}, sep=";", decimal=",")),
    "rotor (rad/s)": GYRO({**RAD, "rotor (rad/s)": SPEED}, speed="rotor (rad/s)"),
    "rotor (rpm)": GYRO({**RAD, "rotor (rpm)": SPEED * 30 / np.pi}, speed="rotor (rpm)"),
    "rotor, unit": GYRO({**RAD, "n": SPEED}, speed="n", speed_unit="rad/s"),
    ".npz": GYRO(partial(makers.npz, arrays=ARRAYS), "a.npz", unit="rad/s"),
    ".bag": GYRO(partial(makers.ros, version=1, topics=makers.TOPICS[:1]), "a.bag", unit="rad/s"),
    ".nc, a steady run": GYRO(makers.steady_run, "b.nc", **STEADY),
    "imu, sensors.csv": GYRO(copied(makers.ROOT / "examples/imu/sensors.csv"), **LOST),
}

# what is read


def digest(array):
    return None if array is None else hashlib.sha256(np.ascontiguousarray(array, dtype=float).tobytes()).hexdigest()


def motion_of(row, folder):
    """Return the motion of a row, and what is said of it: without a warning where no words are expected."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_motion(row.write(Path(folder)), **row.options)
    assert row.says or not caught, caught[0].message
    return found, "; ".join([found.notes, *(str(one.message) for one in caught)])


def rates_of(row, folder):
    return read_rates(row.write(Path(folder)), **row.options)


def told(motion):
    """What the record keeps of a motion."""
    time = motion["time"].values if "time" in motion.coords else None
    facts = {"kind": str(motion.dims[-1]), "shape": list(motion.shape), "start": motion.attrs.get("start")}
    return facts | {"values": digest(motion.values), "time": digest(time)}


def told_of_rates(found):
    parts = ("time", "rates", "acceleration", "speed")
    return {"shape": list(found.rates.shape)} | {name: digest(getattr(found, name)) for name in parts}


def machine():
    """A hash of what the libraries of this machine compute: last bits of sines and of singular values."""
    turned = Rotation.from_euler("ZYX", makers.angles(np.linspace(0, 3, 1000)))
    left, _, right = np.linalg.svd(np.round(turned.as_matrix(), 3))
    return digest(np.concatenate([turned.as_quat().ravel(), turned.as_rotvec().ravel(), (left @ right).ravel()]))


# what is tested

BEFORE = json.loads(RECORDED.read_text(encoding="utf-8"))
SAME_MACHINE = machine() == BEFORE["machine"]
# Not in 0.2.0, which took two recordings of one day for such as begin together.
SINCE = {"time time of day": {"start": 43200.5}, "time time of day, AM": {"start": 0.5}}
STARTS = {None, START, DATES[0].replace(tzinfo=UTC).timestamp(), *(one["start"] for one in SINCE.values())}


def same_times(found, expected, start):
    """Times are compared from the first on; those since 1970 are rounded to 0.24 µs."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert abs(found - found[0] - (expected - expected[0])).max() < (3e-7 if start else 1e-9)


def require_motion(row, folder):
    """Return the motion of a row, which is the true one where rows are not missing, and is said to be so."""
    found, words = motion_of(row, folder)
    values, said = found.values, {note.partition(": ")[0] for note in found.notes.split("; ")}
    assert {"orientation", "time"} <= said, words
    assert {"direction", "checked", "inverted"} & said, words
    assert re.search(row.says, words), words
    if row.truth is not None:
        good = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        assert np.count_nonzero(~good) == row.missing, words
        values, truth = values[good], row.truth[good]
        turned = Rotation.from_quat(values) if found.dims[-1] == "quat" else Rotation.from_matrix(values.swapaxes(1, 2))
        assert (turned.inv() * truth).magnitude().max() < row.within
    if row.truth is not None and row.times is None:
        assert "time" not in found.coords
    elif row.truth is not None:
        same_times(found.time.values, row.times, found.attrs.get("start"))
        assert "rate" not in row.options or found.time[0] == 0
    return found


@pytest.mark.parametrize("name", MOTIONS)
def test_motions(name, tmp_path):
    row = makers.needed(MOTIONS[name])
    found = require_motion(row, tmp_path)
    assert found.attrs.get("start") in STARTS or row.truth is None
    if (row.exact or SAME_MACHINE) and not RENEW:
        assert told(found) == BEFORE["motions"][name] | SINCE.get(name, {})


@pytest.mark.parametrize("name", RATES)
def test_rates(name, tmp_path):
    row = makers.needed(RATES[name])
    found = rates_of(row, tmp_path)
    if row.truth is not None:
        assert abs(found.rates - row.truth).max() < row.within
        assert found.acceleration is None or abs(found.acceleration - makers.ACC).max() < 1e-6
        same_times(found.time, row.times, start=True)
    if found.speed is not None:
        assert abs(found.speed - SPEED).max() < 2e-10
    assert not any(note.startswith("time: none") for note in found.notes)
    if (row.exact or SAME_MACHINE) and not RENEW:
        assert told_of_rates(found) == BEFORE["rates"][name]


def test_rates_of_the_motion():
    """The closed form against differences of the attitudes."""
    e = 1e-5
    differences = (makers.moved(T - e).inv() * makers.moved(T + e)).as_rotvec() / (2 * e)
    assert abs(GYR - differences).max() < 1e-8
    assert abs(Rotation.from_quat(Q).apply(differences) - makers.SPACE).max() < 1e-8
