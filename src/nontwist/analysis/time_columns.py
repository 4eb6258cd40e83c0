"""The time of a recording, from its columns: which of them it is, or numbers of samples and their rate."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from .headers import split_unit
from .time_values import QUALIFIERS, Clock, UnknownTimeError, counted_on, known_unit, numbers, read_times, words_of

TIMES = {"t", "time", "timestamp", "stamp", "datetime", "seconds", "secs", "sec", "epoch", "epoc"}
TIMES |= {"zeit", "temps", "tiempo", "tempo", "tijd"}
COUNTERS = {"packet", "counter", "packetcounter", "frame", "frames", "sample", "samples", "index", "number", "count"}
TEXT = {"txt", "text", "iso", "utc"}  # in brackets behind dates
LIKE_TIME = "time|stamp|date|clock|zeit|datum|temps|heure|tiempo|hora|tijd"


def clock(
    columns: Mapping[str, NDArray[np.generic]], name: str | None, unit: str | None, rate: float | None, count: int
) -> Clock:
    """Return the time of a table of `count` rows.

    Parameters
    ----------
    columns : mapping of header to (n,) array
    name : str, optional
        Header of the time column.
    unit : str, optional
        Of the time column: s, ms, us, ns, min, h, or the seconds that one count lasts.
    rate : float, optional
        Samples a second, from numbers of samples if there are any; a column of times is ignored then.
    count : int

    Raises
    ------
    ValueError
        More than one column may be the time, it is not understood, or it is named although there is a rate; with what
        would help.
    """
    if name is not None:
        if _counts(name) and rate is not None:
            return Clock(*_numbered(columns, name, rate))
        if rate is not None:
            raise ValueError(
                f"--rate (rate=) ignores the times, but {name!r} is named as their column; leave out either"
            )
        return read_times(columns, name, unit)
    times = [header for header in columns if _is_time(header)]
    empty = [header for header in times if _blank(columns[header])]
    notes = [f"time: the column {header!r} is empty" for header in empty]
    read: dict[str, Clock] = {}
    unknown: list[UnknownTimeError] = []
    for header in times:
        if header not in empty:
            try:
                read[header] = read_times(columns, header, unit)
            except UnknownTimeError as error:
                unknown.append(error)
            except ValueError:
                if rate is None:
                    raise
                notes.append(ignored(f"the column {header!r}", None))
    notes += [f"time: not used: {error}" for error in unknown]
    if not read:
        read = _by_unit(columns, times, unit)
        if unknown and not read and rate is None:
            raise unknown[0]
    numbered = next((header for header in columns if _counts(header)), None)
    if rate is not None:
        notes += [ignored(f"the column {header!r}", one.time) for header, one in read.items()]
        if numbered is not None:
            time, _, said = _numbered(columns, numbered, rate)
            return Clock(time, None, [*notes, *said])
        return Clock(np.arange(count) / rate, None, [*notes, f"time: {rate:g} samples a second"])
    if read:
        first, *more = read
        for one in more:
            if not _agree(read[first].time, read[one].time):
                raise ValueError(
                    f"more than one column may be the time: {', '.join(read)}; name one with --time-column "
                    "(time_column=), or the columns to take"
                )
        return replace(read[first], notes=[*notes, *read[first].notes])
    if numbered is not None:
        notes.append(f"time: none; the column {numbered!r} numbers the samples, --rate HZ (rate=) makes times of it")
    other = [h for h in columns if h not in times and (re.search(LIKE_TIME, h.lower()) or _unit_of_time(h))]
    for header in other:
        try:
            found = read_times(columns, header, unit)
        except ValueError as error:
            notes.append(f"time: not used: {error}")
            continue
        if found.start is not None and found.time is not None and _increases(found.time):
            return replace(found, notes=[*notes, *found.notes])
        notes.append(f"time: the column {header!r} may hold times; --time-column (time_column=) reads it")
    if numbered is None and not other:
        notes.append("time: none; --rate HZ (rate=) gives times")
    return Clock(None, None, notes)


def ignored(what: str, time: Array | None) -> str:
    """Return the note on times that a rate replaces, with the average rate that they tell."""
    known = np.array([]) if time is None else time[np.isfinite(time)]
    span = np.ptp(known) if known.size else 0.0
    told = f", {(known.size - 1) / span:.4g} samples a second on average," if span > 0 else ""
    return f"time: {what}{told} is ignored, as --rate (rate=) is given"


def _is_time(header: str) -> bool:
    words, unit = words_of(re.sub(r"^.*\.(?=\D)", "", header))  # in a structure, as data.time
    told = unit is None or known_unit(unit) or unit.lower() in TEXT
    if not words or (not told and len(words) > 1 and not set(words) <= TIMES):
        return False
    return bool(TIMES & set(words)) and set(words) <= TIMES | QUALIFIERS


def _unit_of_time(header: str) -> bool:
    """Whether a header states a unit of time in brackets, or is nothing else: ``Zeit (s)``, ``ms``."""
    name, unit = split_unit(header)
    return known_unit(unit or name) is not None


def _by_unit(columns: Mapping[str, NDArray[np.generic]], tried: Sequence[str], unit: str | None) -> dict[str, Clock]:
    """Return the time by its unit where no name tells: of names with time in them, else the only one that increases."""
    stated = [header for header in columns if header not in tried and _unit_of_time(header)]
    for headers in ([header for header in stated if re.search(LIKE_TIME, header.lower())], stated):
        read: dict[str, Clock] = {}
        for header in headers:
            with suppress(ValueError):
                found = read_times(columns, header, unit or _unit_alone(header))
                if found.time is not None and _increases(found.time):
                    read[header] = found
        first = next(iter(read), None)
        if first is not None and all(_agree(read[first].time, one.time) for one in read.values()):
            return read
    return {}


def _increases(time: Array) -> bool:
    time = time[np.isfinite(time)]
    return bool(time.size > 1 and (np.diff(time) >= 0).all() and time[-1] > time[0])


def _unit_alone(header: str) -> str | None:
    name, unit = split_unit(header)
    return name if unit is None else None


def _counts(header: str) -> bool:
    words, unit = words_of(header)
    return bool(words) and unit is None and set(words) <= COUNTERS


def _blank(values: NDArray[np.generic]) -> bool:
    return bool(values.dtype.kind == "f" and not np.isfinite(values.astype(float)).any()) or values.size == 0


def _agree(a: Array | None, b: Array | None) -> bool:
    """Whether two time columns tell the same intervals, within a hundredth of one."""
    if a is None or b is None:
        return False
    good = np.isfinite(a) & np.isfinite(b)
    a, b = a[good] - a[good][:1], b[good] - b[good][:1]
    return a.size > 1 and bool(abs(a - b).max() <= 0.01 * np.median(abs(np.diff(a))) * max(1.0, a.size / 100))


def _numbered(columns: Mapping[str, NDArray[np.generic]], name: str, rate: float) -> tuple[Array, None, list[str]]:
    """Return times of numbers of samples; a counter that starts anew is counted on."""
    number, note = counted_on(numbers(columns, name), (2**8, 2**16, 2**32))
    finite = number[np.isfinite(number)]
    note = f"time: column {name!r} at {rate:g} samples a second{note}"
    return (number - (finite[0] if finite.size else 0)) / rate, None, [note]
