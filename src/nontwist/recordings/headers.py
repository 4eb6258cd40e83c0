"""Which columns hold an orientation, a gyroscope or an accelerometer, by their headers.

The tables say what makers of sensors call their columns: add a line for a new one. Headers are compared without case,
blanks and marks, and without a unit in brackets at their end: ``Quat_W [-]`` is ``quatw``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from os.path import commonprefix

from ..units import ANGLE, RATE, known, split_unit

QUATERNION = ("quaternions", "quaternion", "quat", "q")  # what may be before a letter or number of a quaternion
# The four letters, the scalar last where its place is known; what is before them, None for anything; whether it is.
QUATERNIONS = (
    ("x y z w", None, True),  # qw, Quat_W, orientation/w, Quat_W_CAL; Motive
    ("i j k r", QUATERNION, True),
    ("x y z s", QUATERNION, True),
    ("i j k real", QUATERNION, True),
    ("x y z scalar", None, True),  # APDM: Upper/Orientation/Scalar
    ("x y z 0", QUATERNION, True),  # NDI: Q0, Qx, Qy, Qz
    ("1 2 3 0", ("quatq",), True),  # Xsens MT Manager
    ("0 1 2 3", QUATERNION, False),
    ("1 2 3 4", QUATERNION, False),
)
# Nine elements of a matrix that maps body to space, row by row.
MATRICES = (
    "11 12 13 21 22 23 31 32 33",  # r11, Mat[1][1]
    "00 01 02 10 11 12 20 21 22",
    "rot0 rot3 rot6 rot1 rot4 rot7 rot2 rot5 rot8",  # Qualisys QTM, column by column: Λ = Rx(roll) Ry(pitch) Rz(yaw)
    "d1x d2x d3x d1y d2y d3y d1z d2z d3z",  # directors
)
# Axis of the angle that a name stands for, at the end of a header; names of angles before x, y, z.
ANGLES = {"roll": "x", "pitch": "y", "yaw": "z", "heading": "z", "azimuth": "z", "course": "z"}
EULER = ("euler", "angle", "eul")
ROTATION_VECTOR = ("rotvec", "rotationvector", "rotvector", "rv", "r", "axisangle")
# Before x, y, z; those of one or two letters are alone there.
GYROSCOPE: tuple[str, ...] = ("gyroscope", "gyro", "gyr", "angularvelocity", "angularrate", "angvel")
GYROSCOPE += ("rotationrate", "gyrorotation", "gyroadc", "gyrorad", "omega", "g", "w")  # Betaflight, PX4
ACCELEROMETER = (
    "accelerometer",
    "acceleration",
    "accel",
    "acc",
    "linearacceleration",
    "accsmooth",
    "accelerometerms2",
    "a",
)
# of other sensors and of bodies, not markers
OTHER: tuple[str, ...] = ("magnetometer", "magneticfield", "mag", "m", "pos", "position", "vel", "velocity")
OTHER += ("speed", "force", "f", "torque", "moment", "trans", "translation")
OF_SENSORS = (*GYROSCOPE, *ACCELEROMETER, *OTHER, *QUATERNION, *ROTATION_VECTOR, "euler")
# Columns that name the sensor, body or frame of each row.
SENSOR = {"sensorid", "sensor", "sensorname", "id", "deviceid", "device", "devicetag", "frameid", "childframeid"}
SENSOR |= {"headerframeid", "topic", "body", "bodyid", "segment", "tag", "address", "mac", "name", "trackerid"}
SENSOR |= {"toolid", "instance", "imu", "i"}  # ArduPilot: I
_RATE_WORDS = r"(?:deg(?:rees)?(?:/|p|per|_)?s(?:ec)?|dps|mdps|rad(?:ians)?(?:/|p|per|_)?s(?:ec)?|rpm)"
_BIAS = re.compile(r"^b_[aw]_|[Bb]ias")  # of a sensor, which filters estimate: EuRoC has b_w_RS_S_x
_REPEATED = re.compile(r"^(.+)\.(\d+)$")


@dataclass(frozen=True)
class Found:
    """4 columns of a quaternion or 9 of a matrix; `ordered`: x, y, z, w, or the matrix row by row."""

    headers: tuple[str, ...]
    ordered: bool
    body: str


def plain(header: str) -> str:
    """Return the letters and digits of a header without its unit, in small letters."""
    return re.sub(r"[^a-z0-9]", "", split_unit(header)[0].lower())


def groups(
    headers: Sequence[str], letters: Sequence[str], name_of: Callable[[str], str] = plain
) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield what is before and after these letters in headers that differ in them alone, and these headers.

    Where a header is repeated, as in ``x y z x y z w``, each of its columns is tried with the others.
    """
    by_name, there = defaultdict[str, list[str]](list), set(headers)
    for header in headers:
        repeated = _REPEATED.match(header)
        by_name[name_of(repeated[1] if repeated and repeated[1] in there else header)].append(header)
    if len(by_name) < len({*letters}):
        return  # above all where a line of prose is the one header
    for name in list(by_name):
        for place in re.finditer(f"(?={letters[0]})", name):
            before, after = name[: place.start()], name[place.start() + len(letters[0]) :]
            found = [by_name[before + one + after] for one in letters if before + one + after in by_name]
            if len(found) == len(letters):
                for row in range(max(map(len, found))):
                    yield before, after, tuple(one[min(row, len(one) - 1)] for one in found)


def orientations(headers: Sequence[str]) -> list[Found]:
    """Return every set of columns that may hold a quaternion, a matrix or directors."""
    sets: dict[frozenset[str], Found] = {}  # of those of the same columns, the first
    for letters, words, is_ordered in QUATERNIONS:
        for before, _, four in groups(headers, letters.split()):
            if words is None or before.endswith(words):
                sets.setdefault(frozenset(four), Found(four, is_ordered, _body(four, "[q]")))
    for letters in MATRICES:
        for before, after, nine in groups(headers, letters.split()):
            if not after and not before.endswith(QUATERNION):
                sets.setdefault(frozenset(nine), Found(nine, True, _body(nine, "[rm]")))
    return [one for one in sets.values() if not _is_part(one, sets.values())]


def _is_part(one: Found, others: Iterable[Found]) -> bool:
    """Whether q1 ... q4 is a part of q0 ... q4, or a quaternion of numbers one whose scalar is known."""
    alike = [other for other in others if other is not one and len(other.headers) == len(one.headers)]
    shared = [other for other in alike if set(one.headers) & set(other.headers)]
    return not one.ordered and any(other.headers[0] < one.headers[0] for other in shared)


def _body(headers: Sequence[str], letter: str) -> str:
    """Return what the headers share before the quaternion or matrix: the name of the body, perhaps empty.

    A single letter of the quaternion or matrix follows the name directly or after a separator; in ``Upper_w`` the last
    letter before the separator is of the name.
    """
    shared = commonprefix(list(headers))  # noqa: RUF071, letter by letter is meant
    name = shared.rstrip(" _.-/[(")
    single = rf"[ _.\-/]*{letter}" if name == shared else rf"(?:^|[ _.\-/]+){letter}"
    return re.sub(rf"(?i)(?:[ _.\-/]*(?:quaternions?|quat|orientation|mat|rot|rotation)|{single})$", "", name)


def _first(header: str) -> str:
    """Return a header without the number of one that repeats it."""
    return _REPEATED.sub(r"\1", header)


def lacks(headers: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return three columns of a quaternion and the plain name of the fourth, where only that is not there."""
    for k, letter in enumerate("wxyz"):
        for before, after, found in groups(headers, "wxyz".replace(letter, "")):
            if before.endswith(QUATERNION):
                return found, before + "wxyz"[k] + after
    return None


def markers(headers: Sequence[str]) -> list[str]:
    """Return the names before or after x, y and z, as ``ELB`` in ``ELB_X``, if they are of no sensor.

    Beside angles, as of the segments of Vicon, there are none.
    """
    if any(known(split_unit(header)[1], ANGLE) for header in headers):
        return []
    axes: dict[str, set[str]] = defaultdict(set)
    for header in headers:
        name = split_unit(header)[0]
        if found := re.fullmatch(r"(.+?)(?:[ _.:\-]+([xyzXYZ])\d*|([XYZ]))|([xyzXYZ])(?:[ _.:\-]+|(?=\d))(.+)", name):
            axes[found[1] or found[5]].add((found[2] or found[3] or found[4]).lower())
    long = tuple(name for name in OF_SENSORS if len(name) > 2)
    whole = [name for name, letters in axes.items() if letters == {*"xyz"}]
    return [name for name in whole if plain(name) not in OF_SENSORS and not plain(name).endswith(long)]


def angle_unit(headers: Iterable[str]) -> str | None:
    """Return ``deg`` or ``rad`` where all headers state it, in brackets or as their last word."""
    named = map(split_unit, map(_first, headers))
    return common(known(unit or re.split(r"[\s_.\-/]", name)[-1], ANGLE) for name, unit in named)


def common(units: Iterable[str | None]) -> str | None:
    """Return what all of these are, None where they differ."""
    stated = set(units)
    return stated.pop() if len(stated) == 1 else None


def _bare(header: str) -> str:
    """Return the plain name of a header without a unit of angles at its end, nor the number of one that repeats."""
    name = plain(_first(header))
    return re.sub(r"(deg|degrees|rad|radians)$", "", name) or name


def angles(headers: Sequence[str], letters: str) -> tuple[str, ...] | None:
    """Return one column of an angle for each axis of `letters`, or None where that is not clear."""
    found = [[h for h in headers if _axis_of_angle(h) == letter.lower()] for letter in letters]
    if any(len(one) > 1 for one in found):  # Roll among DesRoll and the like
        found = [[h for h in one if _bare(h) in ANGLES] for one in found]
    is_clear = all(len(one) == 1 for one in found) and len(set(letters)) == 3
    return tuple(one[0] for one in found) if is_clear else None


def _axis_of_angle(header: str) -> str | None:
    name = _bare(header)
    own = name[-1:] if name[:-1].endswith(EULER) and name[-1:] in "xyz" else None
    return next((axis for word, axis in ANGLES.items() if name.endswith(word)), own)


def rotation_vector(headers: Sequence[str]) -> tuple[str, ...] | None:
    """Return the three columns of a rotation vector, or None where that is not clear."""
    threes = [(before, three) for before, after, three in groups(headers, "xyz", _bare) if not after]
    others = tuple(name for name in (*GYROSCOPE, *ACCELEROMETER, *OTHER) if len(name) > 2)  # accelerometer ends with r
    threes = [(one, three) for one, three in threes if not one.endswith(others)]
    long = [three for one, three in threes if one in ROTATION_VECTOR or (one.endswith(ROTATION_VECTOR) and one[3:])]
    return long[0] if len(long) == 1 else None


def sensors(headers: Sequence[str], names: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return the columns x, y, z of every vector that one of `names` means, with what is before the name.

    Names of one or two letters are alone. Columns that differ in x, y, z alone, and state a unit of angular velocity,
    are of a gyroscope by whatever name. Beside components in the body, which exports of runs name so, others are not.
    """
    found: dict[tuple[str, ...], str] = {}
    own = [h for h in headers if not _BIAS.search(h)]
    all_threes, numbered = (list(groups(own, letters, _without_rate)) for letters in ("xyz", "012"))
    for name in names:
        for before, after, three in all_threes + numbered * (len(name) > 2):
            if not after and before.endswith(name) and (len(name) > 2 or before == name):
                found.setdefault(three, before.removesuffix(name))
    if not found and names is GYROSCOPE:
        found = {three: before for before, _, three in all_threes if all(map(rate_unit, three))}
    material = {
        three: before.removesuffix("material") for three, before in found.items() if before.endswith("material")
    }
    return [(before, three) for three, before in (material or found).items()]


def _without_rate(header: str) -> str:
    """Return the plain name of a header without a unit of angular velocity as its last word."""
    return plain(re.sub(rf"(?i)[ _.\-/]+{_RATE_WORDS}$", "", split_unit(header)[0]))


def rate_unit(*headers: str) -> str | None:
    """Return the unit of angular velocity that all headers state, in brackets or as their last word."""
    last = re.compile(rf"(?i)[ _.\-/]({_RATE_WORDS})$")
    named = ((unit, last.search(name)) for name, unit in map(split_unit, map(_first, headers)))
    return common(known(unit or (found and found[1]), RATE) for unit, found in named)
