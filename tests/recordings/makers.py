"""Files of one motion with known attitudes, rates and times, as the makers of sensors and programs write them.

Floats in text are written with ten decimals, so that files are the same on all machines.
"""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nontwist import save_run, simulate, standard

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"

N = 60
T = np.arange(N) / 50


def angles(t):
    """Yaw, pitch and roll, rad, about moving axes."""
    return np.stack([0.3 + 2 * t, 0.5 * np.sin(3 * t), 0.4 - t], axis=1)


def moved(t):
    return Rotation.from_euler("ZYX", angles(t))


def spins(t):
    """The angular velocity in the body, rad/s, of the derivatives 2, 1.5 cos 3t and -1 of the angles."""
    _, pitch, roll = angles(t).T
    up = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
    across = np.stack([0 * t, np.cos(roll), -np.sin(roll)], axis=1)
    return 2 * up + 1.5 * np.cos(3 * t)[:, None] * across - [1, 0, 0]


R = moved(T)
Q = np.round(R.as_quat(), 12)  # x, y, z, w
WXYZ = np.roll(Q, 1, axis=1)
GYR = spins(T)  # what a gyroscope measures, rad/s
SPACE = R.apply(GYR)  # the same in space
ACC = R.inv().apply([0, 0, 9.81])
MATRICES = np.round(R.as_matrix(), 12)
EULER = R.as_euler("ZYX")


# tables in text


def columns(pattern, letters, values):
    """Columns whose headers differ by a letter, or by one of the words in `letters`."""
    return {pattern.format(x): column for x, column in zip(letters, np.transpose(values), strict=True)}


def quat(pattern, letters="wxyz", values=WXYZ):
    return columns(pattern, letters, values)


def vector(pattern, values, letters="xyz"):
    return columns(pattern, letters, values)


def matrix(pattern, first=1, values=MATRICES):
    """Columns of a matrix in the order of MT Manager, column by column; the first index is the row."""
    places = [(i, j) for j in range(3) for i in range(3)]
    return {pattern.format(i + first, j + first): values[:, i, j] for i, j in places}


def cell(x, decimal=".", sep=","):
    written = f"{x:.10f}".replace(".", decimal) if isinstance(x, float) else str(x)
    return f'"{written}"' if decimal == sep and decimal in written else written


def text(columns, sep=",", decimal=".", head="", below="", headers=True, between=()):
    """A table: `head` above the headers, `below` between them and the rows, `between` after the tenth row."""
    rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
    lines = [sep.join(cell(x, decimal, sep) for x in row) for row in rows]
    lines[10:10] = between
    return head + (sep.join(columns) + "\n") * headers + below + "\n".join(lines) + "\n"


def mt_manager(separator, blocks=("Acc", "Gyr", "Mat")):
    """An export of MT Manager 2022: fields that were not recorded are empty, matrices column by column."""
    table = {"PacketCounter": [f"{51400 + k}" for k in range(N)]}
    table |= {name: [""] * N for name in ("SampleTimeFine", "Year", "Month", "Day", "Second")}
    values = {
        "Acc": vector("Acc_{}", ACC, "XYZ"),
        "Gyr": vector("Gyr_{}", GYR, "XYZ"),
        "Quat": quat("Quat_q{}", "0123"),
        "Euler": vector("{}", np.degrees(EULER), ("Yaw", "Pitch", "Roll")),
        "Mat": matrix("Mat[{}][{}]"),
    }
    for block in blocks:
        table |= {name: [f"{x:.6f}" for x in column] for name, column in values[block].items()}
    head = "// General information: \n//  MT Manager version: 2022.2.0 \n// Coordinate system: ENU\n"
    return text(table, separator, head=head)


def apdm():
    """Two sensors; the attitudes of the second, Lower, are inverted."""
    kinds = [*[f"Acceleration/{x}" for x in "XYZ"], *[f"Angular Velocity/{x}" for x in "XYZ"]]
    kinds += [*[f"Orientation/{x}" for x in ("Scalar", "X", "Y", "Z")], "Temperature/Scalar", "Pressure/Scalar"]
    units = ",".join(["s", *(["m/s^2"] * 3 + ["rad/s"] * 3 + [""] * 4 + ["deg C", "kPa"]) * 2])
    rest = np.tile([22.75, 100.5], (N, 1))
    one, other = (np.hstack([ACC, GYR, q, rest]) for q in (WXYZ, WXYZ * [1, -1, -1, -1]))
    table = {"Time": T, **columns("Upper/{}", kinds, one), **columns("Lower/{}", kinds, other)}
    more = "," * (len(table) - 2)
    return text(table, head=f"Test Name:,Pendulum Test 01{more}\nSample Rate:,128,Hz{more[1:]}\n", below=units + "\n")


def motive(bodies):
    """A CSV of OptiTrack Motive: lines of types, names, identities and kinds above the headers."""
    kinds = ["Rotation"] * 4 + ["Position"] * 3
    names = [name for name in bodies for _ in kinds]
    rows = (
        ["", "Type", *["Rigid Body"] * len(names)],
        ["", "Name", *names],
        ["", "ID", *[str(1 + list(bodies).index(name)) for name in names]],
        ["", "", *kinds * len(bodies)],
        ["Frame", "Time (Seconds)", *"XYZWXYZ" * len(bodies)],
    )
    table = np.hstack([np.hstack([q, 0 * q[:, :3]]) for q in bodies.values()])
    lines = ["Format Version,1.23,Take Name,Take 1,Rotation Type,Quaternion", "", *map(",".join, rows)]
    lines += [",".join([str(k), *map(cell, (t, *row))]) for k, (t, row) in enumerate(zip(T, table, strict=True))]
    return "\n".join(lines)


def qualisys(bodies):
    """A TSV of Qualisys QTM with 6DOF bodies: angles as its manual defines them, matrices column by column."""
    lines = [f"NO_OF_FRAMES\t{N}", "FREQUENCY\t50", "TIME_STAMP\t2020-01-22, 17:47:17\t22107.99179716"]
    heads = ["Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *[f"Rot[{i}]" for i in range(9)]]
    lines += ["\t".join(["BODY_NAMES", *bodies])]
    lines += ["\t".join(["Frame", "Time", *["\t".join([f"{body} X", *heads, ""]) for body in bodies]])]
    for k, t in enumerate(T):
        rows = [
            [0.0, 0.0, 0.0, *rot[k].as_euler("XYZ", degrees=True), 0.5, *rot[k].as_matrix().T.ravel()]
            for rot in bodies.values()
        ]
        lines.append("\t".join([str(k + 1), cell(t), *["\t".join(map(cell, row)) + "\t" for row in rows]]))
    return "\r\n".join(lines)


MVNX = """<?xml version="1.0" encoding="UTF-8"?>
<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">
<mvn version="2019.0.0" build="Version 2018.0.0."/><comment></comment>
<subject label="MVN System 1" frameRate="{:.6f}" segmentCount="2" configuration="UpperBody"><comment></comment>
<segments><segment label="Pelvis" id="1"/><segment label="LeftHand" id="15"/></segments>
<sensors><sensor label="LeftHand"/></sensors>
<frames segmentCount="2" sensorCount="1" jointCount="1">
<frame time="0" index="" type="identity"><orientation>1 0 0 0 1 0 0 0</orientation></frame>
{}</frames></subject></mvnx>
"""


def mvnx(attitudes=R, step=0.02):
    """A file of MVN: times in whole ms, angular velocities of the segments in the global frame."""
    frames = []
    for k, q in enumerate(np.roll(attitudes.as_quat(), 1, axis=1)):
        turned, spin = (" ".join(map(cell, one)) for one in (q, SPACE[k]))
        frames.append(
            f'<frame time="{1000 * step * k:.0f}" index="{k}" tc="00:00:00:00" ms="1542" type="normal">'
            f"<orientation>1 0 0 0 {turned}</orientation><sensorOrientation>{turned}</sensorOrientation>"
            f"<angularVelocity>0 0 0 {spin}</angularVelocity></frame>"
        )
    return MVNX.format(1 / step, "\n".join(frames))


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Arm
  {
    OFFSET 0 1 0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site { OFFSET 0 1 0 }
  }
  JOINT Leg
  {
    OFFSET 0 1 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site { OFFSET 0 1 0 }
  }
}
MOTION
"""


def bvh():
    """Hips turn about z alone, by 0.5 rad/s; the attitude of the arm in space is R, that of the leg as of the hips."""
    hips = Rotation.from_rotvec(np.outer(T, [0, 0, 0.5]))
    table = np.hstack([np.tile([1.0, 2, 3], (N, 1)), hips.as_euler("ZXY", degrees=True)])
    table = np.hstack([table, (hips.inv() * R).as_euler("YXZ", degrees=True), np.zeros((N, 3))])
    rows = [" ".join(cell(float(x)) for x in row) for row in table]
    return f"{BVH}Frames: {N}\nFrame Time: 0.02\n" + "\n".join(rows) + "\n"


def sto(names=("torso_imu", "humerus_imu")):
    """A storage of OpenSim; the first body rests, the others are turned by R."""
    head = "DataRate=50\nDataType=Quaternion\nversion=3\nOpenSimVersion=4.1\nendheader\n"
    turned = [",".join(map(cell, q)) for q in WXYZ]
    rows = zip(T, ["1,0,0,0"] * N, *[turned] * (len(names) - 1), strict=True)
    return head + "\n".join(["\t".join(["time", *names]), *("\t".join(map(cell, row)) for row in rows)]) + "\n"


def mot(degrees):
    head = f"joint angles\nversion=1\nnRows={N}\nnColumns=4\ninDegrees={'yes' if degrees else 'no'}\n\nendheader\n"
    given = R.as_euler("XYZ", degrees=degrees)
    return text({"time": T, **columns("free_rot_{}", "xyz", given)}, "\t", head=head)


# binary files: each writer takes their path


def npy(path, arrays):
    np.save(path, arrays)


def npz(path, arrays):
    np.savez(path, **arrays)


def mat(path, arrays):
    from scipy.io import savemat

    savemat(path, arrays)


def mat73(path, arrays):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file[name] = np.atleast_2d(array).T
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def c3d(path):
    """The first segment rests, the other is turned by R; in single precision."""
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [50]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["m"]
    file["data"]["points"] = np.zeros((4, 1, N))
    poses = np.tile(np.eye(4)[:, :, None, None], (1, 1, 2, N))
    poses[:3, :3, 1] = np.moveaxis(MATRICES, 0, 2).astype(np.float32)
    file.add_parameter("ROTATION", "LABELS", ["pelvis_4X4", "r_larm_4X4"])
    file["data"]["rotations"] = poses
    file.write(str(path))


START = 1_700_000_000  # s since 1970


def ros_message(store, version, kind, k, attitudes):
    """Return the k-th message of a type, and its time in ns."""
    types = store.types
    make = {name: types[f"geometry_msgs/msg/{name}"] for name in ("Quaternion", "Vector3", "Point")}
    stamp = START * 10**9 + 20_000_000 * k
    header = types["std_msgs/msg/Header"](
        **({"seq": k} if version == 1 else {}),
        stamp=types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9),
        frame_id="map",
    )
    turned, zero, nine = make["Quaternion"](*attitudes[k].tolist()), make["Vector3"](0.0, 0.0, 0.0), np.zeros(9)
    rate, up = (make["Vector3"](*np.round(x[k], 12).tolist()) for x in (GYR, ACC))
    pose = types["geometry_msgs/msg/Pose"](make["Point"](0.0, 0.0, 0.0), turned)
    if kind == "sensor_msgs/msg/Imu":
        return types[kind](header, turned, nine, rate, nine, up, nine), stamp
    if kind == "geometry_msgs/msg/PoseStamped":
        return types[kind](header, pose), stamp
    if kind == "nav_msgs/msg/Odometry":
        moving = types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](zero, rate), np.zeros(36)
        )
        return types[kind](
            header, "base", types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)), moving
        ), stamp
    transform = types["geometry_msgs/msg/Transform"](zero, turned)
    one = types["geometry_msgs/msg/TransformStamped"](header, "base", transform)
    return types["tf2_msgs/msg/TFMessage"]([one]), stamp


TOPICS = [("/imu", "sensor_msgs/msg/Imu"), ("/pose", "geometry_msgs/msg/PoseStamped")]
TOPICS += [("/odometry", "nav_msgs/msg/Odometry"), ("/tf", "tf2_msgs/msg/TFMessage")]


def ros(path, version, storage="SQLITE3", topics=TOPICS, attitudes=Q):
    """A bag of version 1, or the folder of one of version 2."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    if version == 1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    plugin = {} if version == 1 else {"version": 8, "storage_plugin": rosbag2.StoragePlugin[storage]}
    with (rosbag1 if version == 1 else rosbag2).Writer(path, **plugin) as writer:
        opened = [(writer.add_connection(topic, kind, typestore=store), kind) for topic, kind in topics]
        for k in range(N):
            for connection, kind in opened:
                message, stamp = ros_message(store, version, kind, k, attitudes)
                pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
                writer.write(connection, stamp + 5, pack(message, kind))


SCLK = """KPL/SCLK
\\begindata
SCLK_KERNEL_ID           = ( @2026-01-01/00:00:00 )
SCLK_DATA_TYPE_9         = ( 1 )
SCLK01_TIME_SYSTEM_9     = ( 1 )
SCLK01_N_FIELDS_9        = ( 2 )
SCLK01_MODULI_9          = ( 4294967296 1000 )
SCLK01_OFFSETS_9         = ( 0 0 )
SCLK01_OUTPUT_DELIM_9    = ( 1 )
SCLK_PARTITION_START_9   = ( 0 )
SCLK_PARTITION_END_9     = ( 4294967295000 )
SCLK01_COEFFICIENTS_9    = ( 0 0 1 )
\\begintext
"""
LSK = """KPL/LSK
\\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K = 1.657D-3
DELTET/EB = 1.671D-2
DELTET/M = ( 6.239996 1.99096871D-7 )
DELTET/DELTA_AT = ( 10, @1972-JAN-1 )
\\begintext
"""


def spice_kernels(path, attitudes=R, spinning=True):
    """A meta-kernel, with a C-kernel of -9000, leapseconds and clock beside it; C-matrices map J2000 to the body."""
    import spiceypy

    folder, ticks = path.parent, 1000 * (100 + T)
    (folder / "clock.tsc").write_text(SCLK, encoding="utf-8")
    (folder / "leap.tls").write_text(LSK, encoding="utf-8")
    (folder / "a.bc").unlink(missing_ok=True)
    quats = np.array([spiceypy.m2q(np.ascontiguousarray(m.T)) for m in attitudes.as_matrix()])
    handle = spiceypy.ckopn(str(folder / "a.bc"), "test", 0)
    about = -9000, "J2000", spinning, "arm", N
    spiceypy.ckw03(handle, ticks[0], ticks[-1], *about, ticks, quats, SPACE * spinning, 1, [ticks[0]])
    spiceypy.ckcls(handle)
    paths = [f"{folder}/{one}" for one in ("leap.tls", "clock.tsc", "a.bc")]
    parts = ["+".join(path[k : k + 60] for k in range(0, len(path), 60)) for path in paths]  # of 80 letters at most
    names = ",\n".join(f"'{part}'".replace("+", "+',\n'") for part in parts)
    path.write_text(f"KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( {names} )\n\\begintext\n", encoding="utf-8")


def old_run(path):
    with zipfile.ZipFile(DATA / "0.1.0.zip") as file:
        path.write_bytes(file.read("run.nc"))


def steady_run(path):
    save_run(simulate(standard(np.diag([1.0, 2, 3])), t_end=1.18, step=0.02, material_angular_velocity=(0, 0, 2)), path)


def copied(path):
    """What writes a file that another program wrote."""
    return lambda to: to.write_bytes(path.read_bytes())


@dataclass(frozen=True)
class Made:
    """A recording: what writes it, how it is read, and the truth.

    `within` is the precision of its attitudes, rad, or of its rates, rad/s. `exact`: what is read passes through no
    function of a library whose last bits differ between machines (sines, singular values). `inner` is what is read
    instead of the file: another one in its folder. `says` is a pattern of what is said. `truth` and `times` are None
    where they are not known.
    """

    content: str | Callable[[Path], None]
    file: str
    options: dict
    truth: Rotation | np.ndarray | None
    times: np.ndarray | None
    within: float
    exact: bool
    encoding: str
    inner: str
    says: str
    missing: int

    def write(self, folder):
        """Write it into a folder and return the path to read."""
        path = folder / self.file
        if isinstance(self.content, str):
            path.write_bytes(self.content.encode(self.encoding))
        else:
            self.content(path)
        return folder / (self.inner or self.file)


def made(
    content,
    file="a.csv",
    truth=R,
    times=T,
    within=5e-10,
    exact=True,
    encoding="utf-8",
    inner="",
    says="",
    missing=0,
    **options,
):
    """Return a recording; columns are a table in CSV, with their time before them."""
    if isinstance(content, dict):
        content = text({"time": T, **content})
    return Made(content, file, options, truth, times, within, exact, encoding, inner, says, missing)


def aem(second):
    head = "META_START\nREF_FRAME_A = ICRF\nQUATERNION_TYPE = FIRST\nMETA_STOP\nDATA_START\nCOMMENT a star tracker\n"
    rows = text({"t": T, **quat("q{}")}, " ", headers=False).splitlines(keepends=True)
    return head + "".join(rows[:9]) + "DATA_STOP\n" + head.replace("ICRF", second) + "".join(rows[9:])


# the library that writes and reads a format, by its suffix; folders are bags
LIBRARIES = {".c3d": "ezc3d", ".bag": "rosbags", "": "rosbags", ".tm": "spiceypy"}


def needed(recording):
    """Skip a recording whose library is not there."""
    suffix = "." + recording.file.rpartition(".")[2] if "." in recording.file else ""
    if suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[suffix])
    return recording
