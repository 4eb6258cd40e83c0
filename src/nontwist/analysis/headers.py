"""Headers of columns: which of them hold an orientation, by their names, in any case and order.

Known are quaternions (``w x y z`` with whatever the four share before and after the letter: ``qw``, ``Quat_W``,
``orientation/w``, ``Quat_W_CAL``; ``qr qi qj qk``; ``Orientation/Scalar``; ``q0 ... q3`` and ``q1 ... q4``, which do
not say where the scalar is), nine elements of a matrix Λ (``r11 ... r33``, ``m00 ... m22``, ``Mat[1][1]``; ``Rot[0] ...
Rot[8]`` column by column, as Qualisys QTM writes them: so they agree with its angles, Λ = Rx(roll) Ry(pitch) Rz(yaw)),
directors (``d1_x ... d3_z``), angles (``roll pitch yaw``, ``Euler_X``) and rotation vectors (``rotvec_x``,
``rx ry rz``); of other sensors, gyroscopes (``gyr_x``, ``gx``, ``wx``, ``Gyroscope x``, ``rotationRateX``) and
accelerometers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os.path import commonprefix
from typing import Literal

ANGLES = {"deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
# Axis of the angle that a name stands for.
NAMED = {"roll": "x", "pitch": "y", "yaw": "z", "heading": "z", "azimuth": "z"}
SCALAR_FIRST = ("quatq",)  # prefixes of numbered quaternions whose maker documents the order: Xsens MT Manager
GYROSCOPE: tuple[str, ...] = ("gyroscope", "gyro", "gyr", "angularvelocity", "angularrate", "angvel")
GYROSCOPE += ("rotationrate", "gyrorotation", "omega", "g", "w")
ACCELEROMETER = ("accelerometer", "acceleration", "accel", "acc", "linearacceleration", "a")
# Spellings of units of angular velocity, as `rate_unit` makes them plain.
RATES = {"rad/s": 1.0, "deg/s": math.pi / 180, "mdeg/s": math.pi / 180e3, "mrad/s": 1e-3, "rpm": math.pi / 30}
_RATE_WORDS = r"(deg(?:rees)?(?:/|p|per|_)?s(?:ec)?|dps|mdps|rad(?:ians)?(?:/|p|per|_)?s(?:ec)?|rpm)"
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\[\]()]*[^\[\]()\d\s][^\[\]()]*)[\])]\s*$")
_QUATERNION = ("q", "quat", "quaternion")
_VECTOR = ("rotvec", "rotationvector", "rotvector", "rv", "r", "axisangle")


@dataclass(frozen=True)
class Found:
    """Columns that hold an orientation together; `ordered`: x, y, z, w, or the matrix row by row."""

    kind: Literal["quaternion", "matrix"]
    headers: tuple[str, ...]
    ordered: bool
    body: str


def split_unit(header: str) -> tuple[str, str | None]:
    """Return the name of a column and the unit in brackets at its end; an index like ``[1]`` is none."""
    match = _BRACKETS.match(header.strip())
    return (match["name"], match["unit"].strip()) if match else (header.strip(), None)


def plain(header: str) -> str:
    """Return the letters and digits of a header without its unit, in small letters."""
    return re.sub(r"[^a-z0-9]", "", split_unit(header)[0].lower())


def listed(names: Iterable[str]) -> str:
    """Return names for a message: as many, and as much of each, as can be read."""
    shown = [name if len(name) <= 80 else f"{name[:80]}..." for name in names]
    return ", ".join(shown[:60]) + (f" and {len(shown) - 60} more" if len(shown) > 60 else "")


def angle_unit(headers: Iterable[str]) -> str | None:
    """Return ``deg`` or ``rad`` where all headers state it, in brackets or as their last word."""
    stated = set()
    for header in headers:
        name, unit = split_unit(header)
        word = (unit or re.split(r"[\s_.\-/]", name)[-1]).lower()
        stated.add(ANGLES.get(word))
    return stated.pop() if len(stated) == 1 else None


def _bare(header: str) -> str:
    """Return the plain name of a header without a unit of angles at its end."""
    name = plain(header)
    return re.sub(r"(deg|degrees|rad|radians)$", "", name) or name


def orientations(headers: Sequence[str]) -> list[Found]:
    """Return every set of columns that holds a quaternion, a matrix or directors."""
    by_name: dict[str, list[str]] = {}
    for header in headers:
        by_name.setdefault(plain(header), []).append(header)

    def group(names: Sequence[str]) -> tuple[str, ...] | None:
        found = [by_name.get(name, []) for name in names]
        return tuple(one[0] for one in found) if all(len(one) == 1 for one in found) else None

    sets: dict[tuple[str, ...], Found] = {}

    def keep(found: tuple[str, ...] | None, kind: Literal["quaternion", "matrix"], ordered: bool) -> None:
        if found is not None:
            sets.setdefault(found, Found(kind, found, ordered, _body(found, kind)))

    for name in by_name:
        for k, letter in enumerate(name):
            before, after = name[:k], name[k + 1 :]
            if letter == "w":
                keep(group([before + x + after for x in "xyzw"]), "quaternion", True)
            if letter in "rs" and before.endswith(_QUATERNION):
                keep(
                    group([before + x + after for x in ("ijk" if letter == "r" else "xyz") + letter]),
                    "quaternion",
                    True,
                )
            if letter in "01" and before.endswith(_QUATERNION):
                numbers = group([f"{before}{int(letter) + i}{after}" for i in range(4)])
                if numbers is not None and (letter == "0" or f"{before}0{after}" not in by_name):
                    known = before.endswith(SCALAR_FIRST) and letter == "0"
                    keep((*numbers[1:], numbers[0]) if known else numbers, "quaternion", known)
        if name.endswith("real") and name[:-4].endswith(_QUATERNION):
            keep(group([name[:-4] + x for x in ("i", "j", "k", "real")]), "quaternion", True)
        if name.endswith("scalar"):
            keep(group([name[:-6] + x for x in ("x", "y", "z", "scalar")]), "quaternion", True)
        if name.endswith("rot0"):  # Qualisys QTM: column by column
            keep(group([f"{name[:-1]}{i + 3 * j}" for i in range(3) for j in range(3)]), "matrix", True)
        for first, order in (("11", "123"), ("00", "012")):
            if name.endswith(first) and not name[:-2].endswith(_QUATERNION):
                keep(group([f"{name[:-2]}{i}{j}" for i in order for j in order]), "matrix", True)
    keep(group([f"d{i}{x}" for x in "xyz" for i in "123"]), "matrix", True)
    return list(sets.values())


def lacks(headers: Sequence[str]) -> tuple[list[str], str] | None:
    """Return three columns of a quaternion and the plain name of the fourth, where only that is not there."""
    for header in headers:
        name = plain(header)
        for k, letter in enumerate(name):
            if letter in "wxyz" and name[:k].endswith(_QUATERNION):
                names = [name[:k] + one + name[k + 1 :] for one in "wxyz"]
                there = [[h for h in headers if plain(h) == one] for one in names]
                if sum(map(bool, there)) == 3:
                    return [one[0] for one in there if one], names[[not one for one in there].index(True)]
    return None


def markers(headers: Sequence[str]) -> list[str]:
    """Return the names that stand before or after x, y and z, as ``ELB`` in ``ELB_X``, if they are of no sensor."""
    axes: dict[str, set[str]] = {}
    for header in headers:
        name = split_unit(header)[0]
        if found := re.fullmatch(r"(.+?)(?:[ _.:\-]+([xyzXYZ])|([XYZ]))|([xyzXYZ])[ _.:\-]+(.+)", name):
            axes.setdefault(found[1] or found[5], set()).add((found[2] or found[3] or found[4]).lower())
    sensors = (*GYROSCOPE, *ACCELEROMETER, "magnetometer", "magneticfield", "mag", "m", *_QUATERNION, *_VECTOR, "euler")
    sensors += ("pos", "position", "vel", "velocity", "speed", "force", "f", "torque", "moment", "trans", "translation")
    long = tuple(name for name in sensors if len(name) > 2)
    whole = [name for name, letters in axes.items() if letters == {*"xyz"}]
    return [name for name in whole if plain(name) not in sensors and not plain(name).endswith(long)]


def _body(headers: Sequence[str], kind: str) -> str:
    """Return what the headers share before the quaternion or matrix: the name of the body, perhaps empty.

    A single letter of the quaternion or matrix follows the name directly or after a separator; in ``Upper_w`` the last
    letter before the separator is of the name.
    """
    shared = commonprefix(list(headers))  # noqa: RUF071, letter by letter is meant
    name = shared.rstrip(" _.-/[(")
    letter = "[q]" if kind == "quaternion" else "[rm]"
    single = rf"[ _.\-/]*{letter}" if name == shared else rf"(?:^|[ _.\-/]+){letter}"
    return re.sub(rf"(?i)(?:[ _.\-/]*(?:quaternion|quat|orientation|mat|rot|rotation)|{single})$", "", name)


def angles(headers: Sequence[str], letters: str) -> tuple[str, ...] | None:
    """Return one column of an angle for each axis of `letters`, or None where that is not clear."""
    found = tuple([h for h in headers if _axis_of_angle(h) == letter.lower()] for letter in letters)
    if any(len(one) > 1 for one in found):  # Roll among DesRoll and the like
        found = tuple([h for h in one if _bare(h) in NAMED] for one in found)
    return tuple(one[0] for one in found) if all(len(one) == 1 for one in found) else None


def _axis_of_angle(header: str) -> str | None:
    name = _bare(header)
    for word, axis in NAMED.items():
        if name.endswith(word):
            return axis
    return name[-1] if name[:-1].endswith(("euler", "angle", "eul")) and name[-1:] in "xyz" else None


def rotation_vectors(headers: Sequence[str]) -> tuple[str, ...] | None:
    """Return the three columns of a rotation vector, or None where that is not clear."""
    by_name = {_bare(header): header for header in headers}
    found = []
    for name in by_name:
        if name.endswith("x") and name[:-1].endswith(_VECTOR) and (name[:-1] in _VECTOR or len(name) > 4):
            three = [name[:-1] + x for x in "xyz"]
            if all(one in by_name for one in three):
                found.append(tuple(by_name[one] for one in three))
    return found[0] if len(found) == 1 else None


def three_axes(headers: Sequence[str], names: Sequence[str]) -> list[tuple[str, tuple[str, str, str]]]:
    """Return the columns x, y, z of every vector that one of `names` means, with what stands before the name.

    Names of one or two letters stand alone.
    """
    by_name: dict[str, str] = {}
    for header in headers:
        by_name.setdefault(_without_rate(header), header)
    found: dict[tuple[str, str, str], str] = {}
    for name in names:
        for one in by_name:
            before = one[: -len(name) - 1]
            if one.endswith(name + "x") and not (before and len(name) < 3):
                x, y, z = (by_name.get(before + name + axis) for axis in "xyz")
                if x is not None and y is not None and z is not None:
                    found.setdefault((x, y, z), before)
    return [(before, three) for three, before in found.items()]


def _without_rate(header: str) -> str:
    """Return the plain name of a header without a unit of angular velocity as its last word."""
    name = split_unit(header)[0]
    return plain(re.sub(rf"(?i)[ _.\-/]+{_RATE_WORDS}$", "", name))


def rate_unit(header: str) -> str | None:
    """Return the unit of angular velocity that a header states, in brackets or as its last word: a key of `RATES`."""
    name, unit = split_unit(header)
    if unit is None:
        last = re.search(rf"(?i)[ _.\-/]({_RATE_WORDS[1:-1]})$", name)
        unit = last[1] if last else ""
    return known_rate(unit)


def known_rate(text: str) -> str | None:
    """Return the key of `RATES` that a spelling means, None where it is none."""
    word = re.sub(r"[\s·*.^()_]", "", text.lower()).replace("º", "°").replace("⁻¹", "-1").replace("−", "-")
    word = word.replace("degrees", "deg").replace("degree", "deg").replace("°", "deg").replace("radians", "rad")
    word = word.replace("radian", "rad").replace("second", "s").replace("sec", "s").replace("per", "/")
    word = {"dps": "deg/s", "mdps": "mdeg/s", "u/min": "rpm", "1/min": "rpm"}.get(word, word)
    word = re.sub(r"^(m?(?:deg|rad))(?:p|/)?s(?:-1)?$", r"\1/s", word)
    return word if word in RATES else None
