"""Which columns hold an orientation, a gyroscope or an accelerometer, by their headers."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from os.path import commonprefix

from ..units import ANGLE, RATE, known, split_unit
from . import spellings

_RATE_WORDS = r"(deg(?:rees)?(?:/|p|per|_)?s(?:ec)?|dps|mdps|rad(?:ians)?(?:/|p|per|_)?s(?:ec)?|rpm)"
_REPEATED = re.compile(r"(.+)\.(\d+)$")


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
    by_name: dict[str, list[str]] = defaultdict(list)
    there = set(headers)
    for header in headers:
        repeated = _REPEATED.match(header)
        once = repeated[1] if repeated and repeated[1] in there else header
        by_name[name_of(once)].append(header)
    for name in list(by_name):
        for k in range(len(name)):
            if not name.startswith(letters[0], k):
                continue
            before, after = name[:k], name[k + len(letters[0]) :]
            found = [by_name[before + one + after] for one in letters if before + one + after in by_name]
            if len(found) == len(letters):
                for row in range(max(map(len, found))):
                    yield before, after, tuple(one[min(row, len(one) - 1)] for one in found)


def orientations(headers: Sequence[str]) -> list[Found]:
    """Return every set of columns that may hold a quaternion, a matrix or directors."""
    found: list[Found] = []
    for letters, words, known_first in spellings.QUATERNIONS:
        for before, _, four in groups(headers, letters.split()):
            if words is None or before.endswith(words):
                names = (*four[1:], four[0]) if known_first else four
                found.append(Found(names, bool(known_first), _body(names, "[q]")))
    for letters in spellings.MATRICES:
        for before, after, nine in groups(headers, letters.split()):
            if not after and not before.endswith(spellings.QUATERNION):
                found.append(Found(nine, True, _body(nine, "[rm]")))
    sets = {frozenset(one.headers): one for one in reversed(found)}  # of those of the same columns, the first
    found = [one for one in found if sets[frozenset(one.headers)] is one]
    return [one for one in found if not _is_part(one, found)]


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


def lacks(headers: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return three columns of a quaternion and the plain name of the fourth, where only that is not there."""
    for k, letter in enumerate("wxyz"):
        for before, after, found in groups(headers, "wxyz".replace(letter, "")):
            if before.endswith(spellings.QUATERNION):
                return found, before + "wxyz"[k] + after
    return None


def markers(headers: Sequence[str]) -> list[str]:
    """Return the names before or after x, y and z, as ``ELB`` in ``ELB_X``, if they are of no sensor."""
    axes: dict[str, set[str]] = defaultdict(set)
    for header in headers:
        name = split_unit(header)[0]
        if found := re.fullmatch(r"(.+?)(?:[ _.:\-]+([xyzXYZ])|([XYZ]))|([xyzXYZ])[ _.:\-]+(.+)", name):
            axes[found[1] or found[5]].add((found[2] or found[3] or found[4]).lower())
    sensors = sum(spellings.OF_SENSORS, ("euler",))
    long = tuple(name for name in sensors if len(name) > 2)
    whole = [name for name, letters in axes.items() if letters == {*"xyz"}]
    return [name for name in whole if plain(name) not in sensors and not plain(name).endswith(long)]


def angle_unit(headers: Iterable[str]) -> str | None:
    """Return ``deg`` or ``rad`` where all headers state it, in brackets or as their last word."""
    stated = {known(unit or re.split(r"[\s_.\-/]", name)[-1], ANGLE) for name, unit in map(split_unit, headers)}
    return stated.pop() if len(stated) == 1 else None


def _bare(header: str) -> str:
    """Return the plain name of a header without a unit of angles at its end."""
    name = plain(header)
    return re.sub(r"(deg|degrees|rad|radians)$", "", name) or name


def angles(headers: Sequence[str], letters: str) -> tuple[str, ...] | None:
    """Return one column of an angle for each axis of `letters`, or None where that is not clear."""
    found = tuple([h for h in headers if _axis_of_angle(h) == letter.lower()] for letter in letters)
    if any(len(one) > 1 for one in found):  # Roll among DesRoll and the like
        found = tuple([h for h in one if _bare(h) in spellings.ANGLES] for one in found)
    return tuple(one[0] for one in found) if all(len(one) == 1 for one in found) else None


def _axis_of_angle(header: str) -> str | None:
    name = _bare(header)
    own = name[-1:] if name[:-1].endswith(spellings.EULER) and name[-1:] in "xyz" else None
    return next((axis for word, axis in spellings.ANGLES.items() if name.endswith(word)), own)


def rotation_vector(headers: Sequence[str]) -> tuple[str, ...] | None:
    """Return the three columns of a rotation vector, or None where that is not clear."""
    names = spellings.ROTATION_VECTOR
    threes = [(before, three) for before, after, three in groups(headers, "xyz", _bare) if not after]
    found = [three for one, three in threes if one in names or (one.endswith(names) and len(one) > 3)]
    return found[0] if len(found) == 1 else None


def sensors(headers: Sequence[str], names: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return the columns x, y, z of every vector that one of `names` means, with what is before the name.

    Names of one or two letters are alone. Columns that differ in x, y, z alone, and state a unit of angular velocity,
    are of a gyroscope by whatever name.
    """
    found: dict[tuple[str, ...], str] = {}
    all_threes = list(groups(headers, "xyz", _without_rate))
    for name in names:
        for before, after, three in all_threes:
            if not after and before.endswith(name) and (len(name) > 2 or before == name):
                found.setdefault(three, before[: len(before) - len(name)])
    if not found and names is spellings.GYROSCOPE:
        found = {three: before for before, _, three in all_threes if all(map(rate_unit, three))}
    return [(before, three) for three, before in found.items()]


def _without_rate(header: str) -> str:
    """Return the plain name of a header without a unit of angular velocity as its last word."""
    return plain(re.sub(rf"(?i)[ _.\-/]+{_RATE_WORDS}$", "", split_unit(header)[0]))


def rate_unit(header: str) -> str | None:
    """Return the unit of angular velocity that a header states, in brackets or as its last word."""
    name, unit = split_unit(header)
    if unit is None:
        last = re.search(rf"(?i)[ _.\-/]({_RATE_WORDS[1:-1]})$", name)
        unit = last[1] if last else None
    return known(unit, RATE)
