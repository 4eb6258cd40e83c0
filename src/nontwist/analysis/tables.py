"""Orientation in the columns of a table: quaternions, matrices, Euler angles and rotation vectors, with their time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .conventions import scalar_by_values
from .headers import (
    ANGLES,
    GYROSCOPE,
    Found,
    angle_unit,
    angles,
    lacks,
    listed,
    markers,
    orientations,
    plain,
    rotation_vectors,
    three_axes,
)
from .time_columns import clock
from .time_values import numbers

Columns = Mapping[str, NDArray[np.generic]]
SAME = 1e-2  # elements of matrices that differ by less are those of the quaternions beside them
MARKERS = 3  # that determine an attitude
IDENTITY = 1e-6  # a first row closer to no rotation than this says where the scalar is


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The options of the caller, as in `nontwist.read_motion`; None: what the recording states itself."""

    columns: Sequence[str] | None = None
    time_column: str | None = None
    body: str | None = None
    scalar_first: bool | None = None
    time_unit: str | None = None
    rate: float | None = None
    euler: str | None = None
    rotation_vector: bool = False
    angle_unit: Literal["deg", "rad"] | None = None


@dataclass(frozen=True)
class Recorded:
    """Attitudes as they were recorded: (n, 4) quaternions, scalar last, or (n, 3, 3) matrices Λ; time, s, or None.

    `start` is what the time counts from, s since 1970, or None; `notes` tell in words what was taken for what; `spin`
    is the (n, 3) angular velocity in space that was recorded beside them, or None.
    """

    values: Array
    time: Array | None
    start: float | None = None
    notes: tuple[str, ...] = ()
    spin: Array | None = None


def table_motion(columns: Columns, how: Reading) -> Recorded:
    """Return the motion that a table holds.

    Raises
    ------
    ValueError
        No orientation, more than one candidate, a column that is missing or not numeric, an unknown unit, angles
        whose order or unit nobody states; with the option that would help.
    """
    count = max((len(values) for values in columns.values()), default=0)
    names, time_name = (None, how.time_column) if how.columns is None else _chosen(columns, how)
    if time_name is not None and time_name not in columns:
        raise ValueError(f"there is no column {time_name!r}; there are {listed(columns)}")
    time = clock(columns, time_name, how.time_unit, how.rate, count)
    if how.euler is not None:
        values, note = _euler(columns, names, how)
    elif how.rotation_vector or (names is not None and len(names) == 3):
        values, note = _rotation_vector(columns, names, how)
    else:
        values, note = _components(columns, names, how)
    return Recorded(values, time.time, time.start, (note, *time.notes))


def _chosen(columns: Columns, how: Reading) -> tuple[list[str], str | None]:
    chosen = list(how.columns or ())
    missing = [name for name in chosen if name not in columns]
    if missing:
        raise ValueError(f"there is no column {missing[0]!r}; there are {listed(columns)}")
    sizes = (3,) if how.euler is not None or how.rotation_vector else (4, 9)
    size = next((n for n in sizes if len(chosen) in (n, n + 1)), None)
    if size is None:
        if len(chosen) in (3, 4):
            raise ValueError(
                "3 columns are angles (--euler, euler=) or a rotation vector (--rotation-vector): specify which"
            )
        raise ValueError(
            "name 4 (quaternion) or 9 (matrix) columns, or 3 with --euler or --rotation-vector, the time before them; "
            f"got {len(chosen)}"
        )
    return chosen[len(chosen) - size :], chosen[0] if len(chosen) > size else how.time_column


def _components(columns: Columns, names: Sequence[str] | None, how: Reading) -> tuple[Array, str]:
    """Return quaternions or matrices and what was taken for them."""
    if names is None:
        found = _one(columns, how)
    else:
        found = Found("matrix" if len(names) == 9 else "quaternion", tuple(names), len(names) == 9, "")
        told = [one for one in orientations(names) if one.ordered and set(one.headers) == set(names)]
        found = told[0] if len(names) == 4 and len(told) == 1 else found
    values = np.stack([numbers(columns, name) for name in found.headers], axis=1)
    named = ", ".join(found.headers)
    if found.kind == "matrix":
        return values.reshape(-1, 3, 3), f"orientation: matrix {found.headers[0]} ... {found.headers[-1]}"
    if found.ordered:
        return values, f"orientation: quaternion {', '.join((*found.headers[3:], *found.headers[:3]))}"
    values, note = scalar_place(values, how, columns, f"the columns {named} do")
    return values, f"{note}, columns {named}"


def scalar_place(values: Array, how: Reading, columns: Columns, who: str) -> tuple[Array, str]:
    """Return (n, 4) quaternions with the scalar last, and how its place was known; `who` did not say it."""
    first, why = (how.scalar_first, "as given") if how.scalar_first is not None else _scalar(values, columns)
    if first is None:
        raise ValueError(
            f"{who} not show which number is the scalar; use --scalar-first or --scalar-last (scalar_first=)"
        )
    note = f"orientation: quaternion, scalar {'first' if first else 'last'} ({why})"
    return np.roll(values, -1, axis=1) if first else values, note


def _scalar(values: Array, columns: Columns) -> tuple[bool | None, str]:
    """Return whether the scalar comes first where the values say it, and why."""
    start = values[:1]
    if start.size and np.isfinite(start).all():
        for first, place in ((True, 0), (False, 3)):
            if np.delete(abs(start[0]), place).max() < IDENTITY and abs(start[0, place]) > 0.99:
                return first, f"the first row is ({', '.join(f'{x:g}' for x in start[0])})"
    return scalar_by_values(values, columns)


def _one(columns: Columns, how: Reading) -> Found:
    found = orientations(list(columns))
    if how.body is not None:
        wanted = plain(how.body)
        if not any(plain(one.body) == wanted for one in found):
            there = ", ".join(one.body for one in found if one.body)
            advice = f"--body (body=) takes one of {there}" if there else "leave --body (body=) out"
            raise ValueError(f"there is no body {how.body!r} in the columns; {advice}")
        found = [one for one in found if plain(one.body) == wanted]
    if len(found) == 1:
        return found[0]
    both = _same_attitude(columns, found)
    if both is not None:
        return both
    if found:
        bodies = [one.body for one in found]
        named = all(bodies) and len(set(bodies)) > 1
        takes = f"--body (body=) takes one of {', '.join(bodies)}; or " if named else ""
        sets = "; ".join(", ".join(one.headers) for one in found)
        raise ValueError(
            f"more than one set of columns contains an orientation ({sets}); {takes}name the columns to take: "
            "--columns (columns=)"
        )
    three = angles(list(columns), "xyz")
    if three is not None:
        raise ValueError(
            f"the columns {', '.join(three)} are angles: give their order with --euler (euler=), as ZYX for yaw, "
            "pitch, roll about the moving axes; zyx is about fixed ones"
        )
    lacking = lacks(list(columns))
    if lacking is not None:
        three_of, fourth = lacking
        raise ValueError(
            f"the columns {', '.join(three_of)} are three of a quaternion, but there is no {fourth!r}; export it, or "
            "name the columns to take: --columns (columns=)"
        )
    rates = three_axes(list(columns), GYROSCOPE)
    marked = markers(list(columns))
    if len(marked) >= MARKERS and not rates:
        raise ValueError(
            f"no columns contain an orientation (qw qx qy qz, or r11 ... r33), but {listed(marked)} look like "
            "positions of markers: three of them on one body determine its attitude, as the page on recordings shows"
        )
    raise ValueError(
        f"no columns contain an orientation (qw qx qy qz, or r11 ... r33): {listed(columns)}; "
        + (f"{', '.join(rates[0][1])} are of a gyroscope, which nontwist fit (fit_inertia) reads; or " if rates else "")
        + "name the columns to use: --columns (columns=), with --euler or --rotation-vector for angles"
    )


def _same_attitude(columns: Columns, found: Sequence[Found]) -> Found | None:
    """Return the quaternion of two sets of columns, a quaternion and a matrix, that hold the same attitudes."""
    kinds = {one.kind: one for one in found}
    if len(found) != 2 or len(kinds) != 2 or not kinds["quaternion"].ordered:
        return None
    from scipy.spatial.transform import Rotation

    try:
        quat, flat = (
            np.stack([numbers(columns, name) for name in kinds[kind].headers], axis=1)
            for kind in ("quaternion", "matrix")
        )
    except ValueError:
        return None
    good = np.isfinite(quat).all(axis=1) & np.isfinite(flat).all(axis=1) & quat.any(axis=1)
    matrices = Rotation.from_quat(quat[good]).as_matrix().reshape(-1, 9)
    same = good.any() and bool(abs(matrices - flat[good]).max() < SAME)
    return kinds["quaternion"] if same else None


def _unit(names: Sequence[str], how: Reading, default: Literal["deg", "rad"] | None) -> str:
    stated = angle_unit(names)
    unit = how.angle_unit or stated or default
    if stated is not None and unit in ("deg", "rad") and unit != stated:
        raise ValueError(
            f"the columns {', '.join(names)} state {stated}, but --angle-unit (angle_unit=) says {unit}; omit the "
            "option, or rename the columns"
        )
    if unit not in ("deg", "rad"):
        raise ValueError(
            f"the columns {', '.join(names)} do not state the unit of their angles: use --angle-unit (angle_unit=) deg "
            "or rad"
            if unit is None
            else f"angle_unit must be 'deg' or 'rad', got {unit!r}; also written {', '.join(ANGLES)} in headers"
        )
    return unit


def _of_body(columns: Columns, how: Reading) -> list[str]:
    """Return the headers that begin with the name of the body, all where none is named."""
    return [name for name in columns if how.body is None or plain(name).startswith(plain(how.body))]


def _euler(columns: Columns, names: Sequence[str] | None, how: Reading) -> tuple[Array, str]:
    letters = str(how.euler)
    if (
        len(letters) != 3
        or not (set(letters) <= set("xyz") or set(letters) <= set("XYZ"))
        or "".join(a for a, b in pairwise(letters) if a == b)
    ):
        raise ValueError(
            f"--euler (euler=) requires three axes, with neighbouring axes different: ZYX about the moving axes, "
            f"zyx about fixed ones; got {letters!r}"
        )
    taken = (
        tuple(names)
        if names is not None
        else angles(_of_body(columns, how), letters)
        if len(set(letters)) == 3
        else None
    )
    if taken is None:
        raise ValueError(
            f"it is not clear which columns are the angles {letters}: {listed(columns)}; name three in this order "
            "with --columns (columns=)"
        )
    unit = _unit(taken, how, None)
    given = np.stack([numbers(columns, name) for name in taken], axis=1)
    about = "moving axes (intrinsic)" if letters.isupper() else "fixed axes (extrinsic)"
    named = ", ".join(taken)
    return euler_quaternions(
        letters, given, unit
    ), f"orientation: Euler angles {letters} about {about}, {unit}: {named}"


def euler_quaternions(letters: str, given: Array, unit: str) -> Array:
    """Return quaternions, scalar last, of (n, 3) angles; rows that are not finite stay so."""
    from scipy.spatial.transform import Rotation

    return _where_finite(given, lambda rows: Rotation.from_euler(letters, rows, degrees=unit == "deg").as_quat())


def _rotation_vector(columns: Columns, names: Sequence[str] | None, how: Reading) -> tuple[Array, str]:
    from scipy.spatial.transform import Rotation

    taken = tuple(names) if names is not None else rotation_vectors(list(columns))
    if taken is None:
        raise ValueError(
            f"it is not clear which columns are the rotation vector: {listed(columns)}; name x, y, z with --columns "
            "(columns=)"
        )
    unit = _unit(taken, how, "rad")
    given = np.stack([numbers(columns, name) for name in taken], axis=1)
    values = _where_finite(given, lambda rows: Rotation.from_rotvec(rows, degrees=unit == "deg").as_quat())
    return values, f"orientation: rotation vector, {unit}: {', '.join(taken)}"


def _where_finite(given: Array, convert: Any) -> Array:
    finite = np.isfinite(given).all(axis=1)
    values = np.full((len(given), 4), np.nan)
    if finite.any():
        values[finite] = convert(given[finite])
    return values
