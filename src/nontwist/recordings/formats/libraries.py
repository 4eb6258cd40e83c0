"""Formats that libraries read: NumPy, MATLAB, C3D, ROS, SPICE, and runs of this package.

Libraries raise what they like on damaged files, or even end their process.

**Arrays by name** are attitudes, or columns. Taken are quaternions (n, 4), matrices (n, 3, 3), homogeneous transforms
(n, 4, 4), those of several bodies (n, k, 4) and (n, k, 3, 3), rotation vectors of joints (n, 3 k) named as those of
SMPL, columns (n,), and (n, 3), as ``gyr``, whose columns are ``gyr_x``, ``gyr_y``, ``gyr_z``. What is not taken is
named in the notes.

Of MATLAB, arrays are read, and fields of structures as ``structure.field``; version 7.3 is read by h5py.

**C3D**: the group ROTATION, 4×4 matrices of segments, as C-Motion describes it and ezc3d reads it: the upper left 3×3
block maps segment to laboratory, the last column is the origin of the segment.

**ROS bags**, version 1 (.bag) and 2 (.db3, .mcap, or their folder), read by rosbags. Orientations are found in messages
of any type with one of the fields `INSIDE`. They map the child or body frame to the frame of the header (REP 103,
geometry_msgs). A topic that several nodes publish is one stream; transforms are a stream for each child frame,
``/tf:camera``. The gyroscope and the accelerometer of sensor_msgs/Imu, and the angular velocity of nav_msgs/Odometry,
which is in its child frame, go along, to tell whether a driver inverts its attitudes.

**SPICE C-kernels**, read by spiceypy through a meta-kernel (.tm) that lists CK, leapseconds and spacecraft clock. A
C-matrix maps vectors from the reference frame to the instrument (CK required reading), so its transpose is Λ. A
C-kernel of type 3 to 6 interpolates: it is sampled at a rate, times are ephemeris seconds from the first sample. The
angular velocity that a segment may have is that of the instrument in the reference frame, with components along it.
"""

from __future__ import annotations

import io
import math
import os
import subprocess
import sys
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...io.run_files import open_run
from ...machine import library
from ..motions import one_motion
from ..options import ReadOptions
from ..table import Content, Table, by_name, listed
from ..times import clock, not_used

Arrays = dict[str, NDArray[np.generic]]
CHILD = (
    "import sys; from importlib import import_module; import numpy; module, function, path = sys.argv[1:]; "
    "found = getattr(import_module(module), function)(path); "
    "numpy.savez(sys.stdout.buffer, **{'_' + name: array for name, array in found.items()})"
)
MEASURED = ("gyr_x (rad/s)", "gyr_y (rad/s)", "gyr_z (rad/s)", "acc_x", "acc_y", "acc_z")
SENSORS = ("angular_velocity", "linear_acceleration")
INSIDE = ("pose", "orientation", "quaternion", "transform", "rotation")
FRAME = "J2000"
MOST = 10_000_000  # samples
JOINTS = ("poses", "pose", "body_pose", "pose_body", "root_orient", "global_orient")  # SMPL, AMASS
RATES = {"mocap_framerate", "mocap_frame_rate", "framerate", "frame_rate", "fps", "rate", "frequency"}
RATES |= {"sampling_rate", "sample_rate", "samplerate", "fs"}
WIDE = 16  # columns of a row of each component, as MATLAB's users keep vectors and quaternions
LARGEST = 4_000_000_000  # bytes of an array of MATLAB
HELP = "save numeric arrays with save('name.mat', ..., '-v7'), or a table with writetable"


@contextmanager
def readable(what: str, help_with: str = "") -> Iterator[None]:
    """Turn every exception that a library raises on a damaged file into an InputError, but for those of the system.

    The message names the format, as in "it is not a readable spin log: damaged, cut short or something else".
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # libraries raise what they like
        if isinstance(error, OSError) and error.errno is not None:
            raise
        why = f"damaged, cut short or something else{help_with}"
        raise InputError("unreadable", what=what, why=why) from error


def reader(name: str, extra: str) -> Any:
    """Import the library that reads a format; an ImportError names the extra that installs it."""
    return library(name, f"this format is read by {name}: pip install 'nontwist[{extra}]'")


def read_apart(function: Callable[[str], Arrays], path: Path) -> Arrays:
    """Return the arrays that a function of a module finds in a file.

    Raises
    ------
    RuntimeError
        Its process did not end well.
    """
    command = [sys.executable, "-c", CHILD, function.__module__, function.__name__, str(path.resolve())]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(one for one in sys.path if one)}
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, env=env)
    if done.returncode:
        raise RuntimeError(f"the process that reads it ended with {done.returncode}")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
        return {name.removeprefix("_"): file[name] for name in file.files}


def read_c3d(path: Path, how: ReadOptions) -> Content:
    """Read the rotations of a file."""
    reader("ezc3d", "c3d")
    with readable("C3D file"):
        found = read_apart(rotations, path)
        matrices = np.asarray(found["matrices"], dtype=float)
        labels, rate = [str(one) for one in found["labels"]], float(np.asarray(found["rate"], dtype=float))
    if matrices.ndim != 4 or matrices.shape[2] == 0 or matrices.shape[3] == 0:
        raise InputError("no-rotations")
    names = [labels[k] if k < len(labels) else f"rotation {k + 1}" for k in range(matrices.shape[2])]
    bodies = by_name("segment", ((name, np.moveaxis(matrices[:3, :3, k, :], 2, 0)) for k, name in enumerate(names)))
    time = np.arange(matrices.shape[3]) / rate if rate > 0 else None
    return Content(bodies=bodies, time=time, notes=("orientation: matrices of the group ROTATION",))


def rotations(path: str) -> dict[str, Any]:
    """Return the matrices of a file, (4, 4, bodies, frames), their labels and rate; run in a process of its own."""
    import ezc3d

    file = ezc3d.c3d(path)
    group = file["parameters"].get("ROTATION", {})
    labels = [str(one) for one in group.get("LABELS", {}).get("value", [])]
    rates = [*np.ravel(group.get("RATE", {}).get("value", [])), file["header"]["points"]["frame_rate"]]
    matrices = np.asarray(file["data"]["rotations"], dtype=float)
    return {"matrices": matrices, "labels": np.array(labels, dtype=str), "rate": np.array(float(rates[0]))}


def read_ros(path: Path, how: ReadOptions) -> Content:
    """Read the orientations of the topic or child frame ``body``, or of the only one that has any."""
    highlevel, typesys = (reader(f"rosbags.{name}", "ros") for name in ("highlevel", "typesys"))
    folder = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").exists() else path
    streams: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    with readable("ROS bag"):
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with highlevel.AnyReader([folder], default_typestore=store) as bag:
            topics = list(dict.fromkeys(one.topic for one in bag.connections))
            asked = [one for one in bag.connections if how.body and how.body.partition(":")[0] == one.topic]
            silent = set[str]()  # types without orientations
            for connection, stamp, raw in bag.messages(connections=asked or bag.connections):
                if connection.msgtype in silent:
                    continue
                message = bag.deserialize(raw, connection.msgtype)
                found = _orientations(message, connection.topic)
                if not found and not hasattr(message, "transforms") and not hasattr(message, "orientation_covariance"):
                    silent.add(connection.msgtype)
                for name, q, clock in found:
                    streams[name].append((clock or stamp * 1e-9, q.x, q.y, q.z, q.w, *_measured(message)))
    if not streams:
        raise InputError("no-messages", topics=listed(topics) or "none")
    named = [name for name in streams if how.body in (None, name, name.partition(":")[2])]
    if len(named) != 1:
        raise InputError("which-topic", names=listed(named or streams))
    rows = np.array(sorted(streams[named[0]], key=lambda row: row[0]), dtype=float)
    start, bodies = float(rows[0, 0]), {named[0]: rows[:, 1:5]}
    note = f"orientation: topic {named[0]}, body to the frame of its header"
    columns = {name: one for name, one in zip(MEASURED, rows[:, 5:].T, strict=True) if np.isfinite(one).any()}
    return Content(Table(columns), bodies, time=rows[:, 0] - start, start=start, notes=(note,))


def _measured(message: Any) -> tuple[float, ...]:
    """Return what gyroscope and accelerometer measured in the frame of the body, nan where there are none."""
    names = [name for name in SENSORS if getattr(message, f"{name}_covariance", (-1,))[0] != -1]
    vectors = [getattr(message, name) if name in names else None for name in SENSORS]
    if hasattr(message, "child_frame_id") and hasattr(message, "twist"):
        vectors = [message.twist.twist.angular, None]
    return tuple(x for one in vectors for x in ((math.nan,) * 3 if one is None else (one.x, one.y, one.z)))


def _orientations(message: Any, name: str) -> list[tuple[str, Any, float]]:
    """Return name, quaternion and time, 0 without one, of every orientation in a message."""
    if hasattr(message, "transforms"):
        return [found for one in message.transforms for found in _orientations(one, f"{name}:{one.child_frame_id}")]
    inner = message
    while inner is not None and not all(hasattr(inner, x) for x in "xyzw"):
        inner = next((getattr(inner, one) for one in INSIDE if hasattr(inner, one)), None)
    if inner is None or getattr(message, "orientation_covariance", (0,))[0] == -1:
        return []  # a device of sensor_msgs/Imu may have no estimate of its orientation
    header = getattr(message, "header", None)
    return [(name, inner, 0.0 if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec)]


def read_spice(path: Path, how: ReadOptions) -> Content:
    """Read the attitude of the instrument or structure ``body``, its NAIF number, against J2000.

    Kernels that the process has loaded stay loaded.
    """
    spice = reader("spiceypy", "spice")
    if how.rate is None:
        raise InputError("no-rate")
    with readable("meta-kernel of CK, leapseconds (LSK) and spacecraft clock (SCLK)"):
        before = {spice.kdata(k, "CK")[0] for k in range(spice.ktotal("CK"))}
        spice.furnsh(str(path))
        try:
            kernels = [spice.kdata(k, "CK")[0] for k in range(spice.ktotal("CK"))]
            objects = {int(one): kernel for kernel in kernels if kernel not in before for one in spice.ckobj(kernel)}
            named = [one for one in objects if how.body in (None, str(one))]
            samples = list(_sampled(spice, objects[named[0]], named[0], how.rate)) if len(named) == 1 else []
        finally:
            spice.unload(str(path))
    if len(named) != 1:
        raise InputError("which-instrument", names=", ".join(map(str, objects)) or "none is there")
    if not samples:
        raise InputError("no-samples")
    times, matrices, spins = (np.array(one) for one in zip(*samples, strict=True))
    name = str(named[0])
    note = f"orientation: C-kernel of {name} against {FRAME}, time in ephemeris seconds"
    known = {} if np.isnan(spins).any() else {name: spins}
    attitudes = {name: np.swapaxes(matrices, 1, 2)}
    return Content(bodies=attitudes, spins=known, time=times - times[0], sampled=True, notes=(note,))


def _sampled(spice: Any, kernel: str, body: int, rate: float) -> Iterator[tuple[float, Any, Any]]:
    """Yield times, C-matrices and angular velocities, NaN without them, at `rate` inside what the kernel covers."""
    cover, left = spice.ckcov(kernel, body, False, "INTERVAL", 0.0, "TDB"), MOST
    for k in range(spice.wncard(cover)):
        first, last = spice.wnfetd(cover, k)
        times = first + np.arange(min(int((last - first) * rate) + 1, left)) / rate
        left -= len(times)
        for time in times:
            ticks = spice.sce2c(int(body / 1000), time)
            try:
                matrix, spin, _ = spice.ckgpav(body, ticks, 0.0, FRAME)
            except spice.NotFoundError:  # there is none with an angular velocity
                try:
                    matrix, spin = spice.ckgp(body, ticks, 0.0, FRAME)[0], np.full(3, np.nan)
                except spice.NotFoundError:
                    continue
            yield float(time), matrix, spin


def read_numpy(path: Path, how: ReadOptions) -> Content:
    """Read one array, or an archive of arrays."""
    kind = path.suffix[1:].upper()
    with open(path, "rb") as stream:
        try:
            if kind == "NPZ":
                zipfile.ZipFile(stream).close()
                stream.seek(0)
            found = np.load(stream, allow_pickle=False)
            named = {"array": found} if isinstance(found, np.ndarray) else {name: found[name] for name in found.files}
            arrays = {name: np.asarray(one) for name, one in named.items()}  # what is no array are bytes
        except Exception as error:  # zipfile, zlib and NumPy raise what they like
            is_pickled = "pickle" in str(error)
            why = "it holds objects of Python; save arrays of numbers" if is_pickled else "damaged or cut short"
            raise InputError("unreadable", what=f"{kind} file", why=why) from error
    return of_arrays(arrays, how)


def of_arrays(arrays: Mapping[str, Any], how: ReadOptions) -> Content:
    """Return the content of named arrays; an array `directors` holds directors in rows, any other (n, 3, 3) Λ.

    A rate among them gives times where no column does.
    """
    columns, bodies, loose = dict[str, Any](), dict[str, Any](), dict[str, Any]()
    notes, headless = list[str](), False
    for name, array in arrays.items():
        if array.ndim == 2 and len(array) in (3, 4) and array.shape[1] > WIDE:
            array = array.T  # samples in columns
        shape, end, is_numeric = array.shape, array.shape[1:], array.dtype.kind in "fiu"
        numbers = np.asarray(array, dtype=float) if is_numeric else np.empty(0)
        if array.dtype.names is not None:
            columns |= {field: np.ravel(array[field]) for field in array.dtype.names}
        elif is_numeric and end == (3, 3):
            bodies[name] = np.swapaxes(numbers, 1, 2) if name == "directors" else numbers
        elif is_numeric and end == (4, 4) and (array[:, 3] == [0, 0, 0, 1]).all():
            bodies[name] = numbers[:, :3, :3]
        elif is_numeric and end == (4,):
            loose[name] = numbers
        elif is_numeric and end[1:] in ((4,), (3, 3)):
            (loose if end[1:] == (4,) else bodies).update({f"{name} {k}": numbers[:, k] for k in range(end[0])})
        elif is_numeric and name in JOINTS and len(end) == 1 and end[0] and end[0] % 3 == 0:
            from scipy.spatial.transform import Rotation

            turned = Rotation.from_rotvec(numbers.reshape(-1, 3)).as_quat().reshape(len(array), -1, 4)
            bodies |= {name if end == (3,) else f"{name} {k}": turned[:, k] for k in range(end[0] // 3)}
        elif len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            columns[name] = np.ravel(array)
        elif is_numeric and end == (3,) and len(arrays) > 1:
            columns |= {f"{name}_{x}": array[:, k] for k, x in enumerate("xyz")}
        elif len(shape) == 2 and len(arrays) == 1:
            columns, headless = {str(k + 1): array[:, k] for k in range(shape[1])}, True
        elif name.lower() not in RATES:
            notes.append(f"not read: the array {name!r} of the shape {shape}")
    if notes and not (columns or bodies or loose):
        raise InputError("no-attitudes", help="; ".join(notes))
    known = next((float(one.item()) for name, one in arrays.items() if name.lower() in RATES and one.size == 1), 0.0)
    count = max(map(len, [*bodies.values(), *loose.values()] or columns.values()), default=0)
    time = np.arange(count) / known if known > 0 and count else None
    table = Table(columns, headless=headless)
    if time is not None and how.rate is None:
        own = replace(table, columns={name: values for name, values in columns.items() if len(values) == count})
        try:
            told = clock(own, how).time
        except InputError as error:
            if how.time_column or how.time_unit:
                raise
            told = None
            notes.append(not_used(error))
        if told is not None:
            if not abs(told - told[0] - time).max() < 0.5 / known:
                notes.append(f"time: not used: {known:g} samples a second, from which the times differ")
            table, time = own, None
        elif not (bodies or loose):
            table, time = replace(own, columns={"time (s)": time} | dict(own.columns)), None
    return Content(table, bodies, loose, time=time, notes=tuple(notes), directed=False)


def read_matlab(path: Path, how: ReadOptions) -> Content:
    """Read the arrays of a file."""
    found: dict[str, Any] = {}
    with readable("MAT file", f"; {HELP}"):
        with open(path, "rb") as stream:
            modern = b"MATLAB 7.3" in stream.read(128)
        if modern:
            import h5py

            with h5py.File(path, "r") as file:
                file.visititems(lambda name, item: _keep(found, name.replace("/", "."), item))
        else:
            found = read_apart(loaded, path)
    content = of_arrays(found, how)
    if not (content.table.columns or content.bodies or content.loose):
        raise InputError("no-attitudes", help=HELP)
    return content


def loaded(path: str) -> dict[str, Any]:
    """Return the numeric arrays of a file up to version 7; run in a process of its own."""
    from scipy.io import loadmat

    found: dict[str, Any] = {}
    for name, value in loadmat(path, squeeze_me=False, struct_as_record=True).items():
        if not name.startswith("__"):
            _flatten(found, name, value)
    return found


def _keep(found: dict[str, Any], name: str, item: Any) -> None:
    """Take a numeric array of a 7.3 file, whose axes are in reverse; none whose numbers are kept in other files."""
    if hasattr(item, "shape") and item.dtype.kind in "fiu" and not name.startswith("#"):
        if item.is_virtual or item.external or item.nbytes > LARGEST:
            raise ValueError
        _flatten(found, name, np.asarray(item).T)


def _flatten(found: dict[str, Any], name: str, value: Any) -> None:
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names is not None:
        for field in value.dtype.names if value.size == 1 else ():
            _flatten(found, f"{name}.{field}", value.ravel()[0][field])
    elif value.dtype.kind in "fiu":
        found[name] = np.moveaxis(value, 2, 0) if value.ndim == 3 and value.shape[:2] in ((3, 3), (4, 4)) else value


def read_run(path: Path, how: ReadOptions) -> Content:
    """Read the attitudes of a run."""
    run = open_run(path)
    found = one_motion(run, how.scalar_first)
    return Content(bodies={path.stem: found.values}, time=found.time, notes=("orientation: a run of this package",))
