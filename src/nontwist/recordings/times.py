"""The time of a recording: which columns tell it, in what unit, from when on.

A clock that starts again is counted on where its period is known: counters of 8 to 32 bits, hours, half days, days,
weeks of GPS. Spreadsheets count days since 1899-12-30, MATLAB since the year 0; both are told by their size and steps.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.arrays import Array, as_floats, as_plain
from ..units import TIME, known, split_unit
from . import spellings
from .options import ReadOptions
from .table import Table, listed, number

if TYPE_CHECKING:
    import pandas

EPOCH = (3e8, 4.2e9)  # s since 1970 that are taken for dates: 1979 to 2103
DAYS = {"of a spreadsheet": (20_000.0, 80_000.0, 25_569), "of MATLAB": (700_000.0, 780_000.0, 719_529)}
RARE = 60.0  # s between samples; what lies further apart as seconds since 1970 are ticks
COARSE = 5.0  # whole numbers without a unit that are as far apart are not seconds
BITS = (2.0**8, 2.0**16, 2.0**24, 2.0**31, 2.0**32)
PERIODS = {60.0: "a minute", 3600.0: "an hour", 43200.0: "half a day", 86400.0: "a day", 604800.0: "a week of GPS"}
PERIODS |= {2.0**n * tick: f"{2**n} {unit}" for n in (16, 31, 32) for tick, unit in ((1e-3, "ms"), (1e-6, "µs"))}
NEW, MOST = 0.1, 25.0  # of a period, and of the median step, at most, that a step over its end may last
_SLASHED = r"^(\d\d?)/(\d\d?)/(\d{4})(?=\D|$)"


@dataclass(frozen=True)
class Clock:
    """Times, s; `start` is what they count from, s since 1970, where the recording tells dates; `notes` in words."""

    time: Array | None = None
    start: float | None = None
    notes: tuple[str, ...] = ()
    has_unit: bool = True


class UnknownTimeError(InputError):
    """A time column cannot be understood without being told its unit, or holds no times."""


def clock(table: Table, how: ReadOptions) -> Clock:
    """Return the time of a table; an InputError where it is not understood, or may be that of several columns."""
    name, unit, rate = how.time_column, how.time_unit, how.rate
    if name is not None:
        table.require(name)
        if rate is not None and not _counts(name):
            raise InputError("rate-and-time", name=name)
        return read_times(table, name, unit) if rate is None else _of_counter(table, name, rate)
    if rate is not None:
        how.require_without("time_unit", "a rate gives the times")
    pairs = _two_columns(table)
    times = [h for h in table.headers if _is_time(h) and h not in {one for pair in pairs for one in pair[:2]}]
    empty = [h for h in times if not _has_values(table.columns[h])]
    notes = [f"time: the column {h!r} is empty" for h in empty]
    read: dict[str, Clock] = {f"{one} and {two}": _together(table, one, two, of) for one, two, of in pairs}
    unknown: list[UnknownTimeError] = []
    for h in [h for h in times if h not in empty]:
        try:
            read[h] = read_times(table, h, unit)
        except UnknownTimeError as error:
            unknown.append(error)
        except ValueError:
            if rate is None:
                raise
            notes.append(ignored(f"the column {h!r}", None))
    notes += [f"time: not used: {error}" for error in unknown]
    if not read:
        read = _by_unit(table, times, unit)
        if unknown and not read and rate is None:
            raise unknown[0]
    counter = next((h for h in table.headers if _counts(h)), None)
    if rate is not None:
        notes += [ignored(f"the column {h!r}", one.time) for h, one in read.items()]
        found = Clock(np.arange(len(table)) / rate, None, (f"time: {rate:g} samples a second",))
        found = found if counter is None else _of_counter(table, counter, rate)
        return replace(found, notes=(*notes, *found.notes))
    if read:
        first, *more = read
        if all(h not in table.columns or table.columns[h].dtype.kind not in "iuf" for h in read):
            how.require_without("time_unit", "the times state theirs")
        if not all(_agree(read[first].time, read[one].time) for one in more):
            raise InputError("several-times", names=listed(read))
        return replace(read[first], notes=(*notes, *read[first].notes))
    if counter is not None:
        notes.append(f"time: none; the column {counter!r} numbers the samples, a rate makes times of it")
    for h in table.headers:
        if h in times or not (re.search(spellings.LIKE_TIME, h.lower()) or _unit_of_time(h)):
            continue
        try:
            found = read_times(table, h, unit)
        except ValueError as error:
            notes.append(f"time: not used: {error}")
            continue
        if found.start is not None and _increases(found.time):
            return replace(found, notes=(*notes, *found.notes))
        notes.append(f"time: the column {h!r} may hold times; name it as the time column to use it")
    how.require_without("time_unit", "no column of times is found")
    if not any(note.startswith("time: ") for note in notes):
        notes.append("time: none; a rate gives times")
    return Clock(None, None, tuple(notes))


def ignored(what: str, time: Array | None) -> str:
    """Return the note on times that a rate replaces, with the average rate that they tell."""
    finite = np.array([]) if time is None else time[np.isfinite(time)]
    span = np.ptp(finite) if finite.size else 0.0
    average = f", {(finite.size - 1) / span:.4g} samples a second on average," if span > 0 else ""
    return f"time: {what}{average} is ignored, as a rate is given"


def words_of(header: str) -> tuple[list[str], str | None]:
    """Return the words of a header in small letters, and its unit, in brackets or as its last word."""
    name, unit = split_unit(header)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = [word for word in re.split(r"[^a-zµμ]+", spaced.lower()) if word]
    beside = spellings.BESIDE_TIME - {"elapsed"}
    if unit is None and len(words) > 1 and known(words[-1], TIME) and words[-2] not in beside:
        unit = words.pop()
    return words, unit


def _is_time(header: str) -> bool:
    words, unit = words_of(re.sub(r"^.*\.(?=\D)", "", header))  # in a structure, as data.time
    told = unit is None or known(unit, TIME) or unit.lower() in ("txt", "text", "iso", "utc")
    if not words or (not told and len(words) > 1 and not set(words) <= spellings.TIMES):
        return False
    is_elapsed = "elapsed" in words and known(unit, TIME) is not None
    return bool(spellings.TIMES & set(words) or is_elapsed) and set(words) <= spellings.TIMES | spellings.BESIDE_TIME


def _unit_of_time(header: str) -> bool:
    """Whether a header states a unit of time in brackets, or is nothing else: ``Zeit (s)``, ``ms``."""
    name, unit = split_unit(header)
    return known(unit or name, TIME) is not None


def _by_unit(table: Table, tried: Sequence[str], unit: str | None) -> dict[str, Clock]:
    """Return the time by its unit where no name tells: of names with time in them, else the only one that increases."""
    stated = [h for h in table.headers if h not in tried and _unit_of_time(h)]
    for headers in ([h for h in stated if re.search(spellings.LIKE_TIME, h.lower())], stated):
        read: dict[str, Clock] = {}
        for h in headers:
            name, own = split_unit(h)
            with suppress(ValueError):
                found = read_times(table, h, unit or (name if own is None else None))
                if _increases(found.time):
                    read[h] = found
        first = next(iter(read), None)
        if first is not None and all(_agree(read[first].time, one.time) for one in read.values()):
            return read
    return {}


def _increases(time: Array | None) -> bool:
    finite = np.array([]) if time is None else time[np.isfinite(time)]
    return bool(finite.size > 1 and (np.diff(finite) >= 0).all() and finite[-1] > finite[0])


def _counts(header: str) -> bool:
    words, unit = words_of(header)
    return bool(words) and unit is None and set(words) <= spellings.COUNTERS


def _has_values(values: NDArray[Any]) -> bool:
    return values.size > 0 and not (values.dtype.kind == "f" and not np.isfinite(values).any())


def _agree(a: Array | None, b: Array | None) -> bool:
    """Whether two time columns tell the same intervals, within a hundredth of one."""
    if a is None or b is None:
        return False
    good = np.isfinite(a) & np.isfinite(b)
    a, b = a[good] - a[good][:1], b[good] - b[good][:1]
    return a.size > 1 and bool(abs(a - b).max() <= 0.01 * np.median(abs(np.diff(a))) * max(1.0, a.size / 100))


def _two_columns(table: Table) -> list[tuple[str, str, str]]:
    """Return the pairs of columns that tell a time together, and the unit of the second, "" for a time of day."""
    by_words = {tuple(re.findall(r"[a-zµ]+", h.lower())): h for h in table.headers}
    pairs = []
    for words, h in by_words.items():
        for one, two, unit in spellings.TWO_COLUMNS:
            other = next((by_words[key] for last in two if (key := (*words[:-1], last)) in by_words), None)
            if words and words[-1] in one and other is not None:
                texts = [str(table.columns[name][:1]) for name in (h, other)]
                rest = table.columns[other]
                is_rest = unit and rest.dtype.kind in "fiu" and rest.size and np.nanmax(rest) * TIME[unit] <= 1
                if is_rest or (not unit and ":" not in texts[0] and ":" in texts[1]):
                    pairs.append((h, other, unit))
    return pairs[:1]


def _together(table: Table, one: str, two: str, unit: str) -> Clock:
    note = f"time: columns {one!r} and {two!r}"
    if not unit:
        dates = [f"{a} {b}" for a, b in zip(table.columns[one].tolist(), table.columns[two].tolist(), strict=True)]
        found = read_times(Table({one: np.array(dates, dtype=object)}, table.lines), one, None)
        return replace(found, notes=(note,))
    whole, rest = table.numbers(one), table.numbers(two) * TIME[unit]
    k = next(iter(np.flatnonzero(np.isfinite(whole + rest))), 0)
    ahead = (whole - whole[k]) + (rest - rest[k])
    start = whole[k] + rest[k]
    is_date = EPOCH[0] < start < EPOCH[1]
    return Clock(ahead if is_date else ahead + start, float(start) if is_date else None, (f"{note}, s and {unit}",))


def counted_on(ticks: Array, periods: dict[float, str]) -> tuple[Array, str]:
    """Return a clock of one of these periods without its starts again, and what is to be said of them."""
    finite = np.isfinite(ticks)
    back = np.diff(ticks[finite])
    over = back < 0
    if not over.any():
        return ticks, ""
    low, high = ticks[finite].min(), ticks[finite].max()
    step = float(np.median(back[back > 0])) if (back > 0).any() else 0.0
    for period in sorted(periods):
        over = back < -max((1 - NEW) * period, period - MOST * step)
        if high - low < period and over.any() and over.sum() >= (back < -period / 2).sum():
            ticks = ticks.copy()
            ticks[finite] += period * np.append(0, np.cumsum(over))
            return ticks, f", counted on where it starts again after {periods[period]}"
    return ticks, ""


def read_times(table: Table, name: str, unit: str | None) -> Clock:
    """Return the times of one column."""
    values = np.asarray(table.columns[name])
    words, stated = words_of(name)
    is_text = values.dtype.kind in "OUST" and next((number(v) is None for v in values.tolist() if v is not None), True)
    if values.dtype.kind in "mM" or is_text:
        if unit is not None and known(unit, TIME) is None and number(unit) is None:
            raise _unknown_unit(unit, name)
        dates, order = (values, "") if values.dtype.kind in "mM" else _dates(values, name)
        return _dated(dates, name, order)
    given = unit if unit is not None else stated
    scale = _scale(given, name, stated is None or unit is not None)
    if unit is not None and known(stated, TIME) not in (None, known(unit, TIME)):
        raise InputError("time-unit-stated", name=name, stated=known(stated, TIME), unit=unit)
    ticks = table.numbers(name)
    finite = ticks[np.isfinite(ticks)]
    first = float(finite[0]) if finite.size and (values.dtype.kind in "iu" or abs(finite[0]) > EPOCH[0]) else 0.0
    is_exact = values.dtype.kind in "iu" and values.size
    ahead = (values.astype(np.int64) - np.int64(values[0])).astype(float) if is_exact else ticks - first
    has_unit, days = scale is not None, None
    if scale is None:
        days = next((day for day in DAYS.items() if _are_days(finite, *day[1][:2])), None)
        scale = 86400.0 if days else _guess(first, ahead, name, tuple(words))
        if stated is not None and not days and not EPOCH[0] < first * scale < EPOCH[1]:
            raise _unknown_unit(stated, name)
    if days:
        start = (finite[0] - days[1][2]) * 86400.0
        return Clock((ticks - finite[0]) * scale, float(start), (f"time: column {name!r}, days {days[0]}",))
    over = ""
    if (np.diff(ahead[np.isfinite(ahead)]) < 0).any():
        periods = {one: str(int(one)) for one in BITS}
        if abs(finite[0] - finite.min()) > _step(finite):  # else recordings that begin at zero follow each other
            periods |= {one / scale: told for one, told in PERIODS.items()}
        ticks, over = counted_on(ticks, periods)
        ahead = ticks - first if over else ahead
    symbol = next((symbol for symbol, one in TIME.items() if one == scale), f"counts of {scale:g} s")
    if EPOCH[0] < first * scale < EPOCH[1]:
        return Clock(ahead * scale, first * scale, (f"time: column {name!r}, {symbol} since 1970{over}",))
    how = "" if has_unit else ", as nothing else is stated"
    return Clock((ahead + first) * scale, None, (f"time: column {name!r}, {symbol}{how}{over}",), has_unit)


def _unknown_unit(unit: str, name: str) -> InputError:
    return InputError("time-unit", unit=unit, name=name, units=", ".join(TIME))


def _scale(given: str | None, name: str, strict: bool) -> float | None:
    """Return the seconds of a unit; None where there is none, or its header has something else in brackets."""
    symbol, seconds = known(given, TIME), number(given)
    if symbol is not None:
        return TIME[symbol]
    if seconds is not None and 0 < seconds < np.inf:
        return seconds
    if given and strict:
        raise _unknown_unit(given, name)
    return None


def _step(times: Array) -> float:
    finite = times[np.isfinite(times)]
    return float(np.median(abs(np.diff(finite)))) if finite.size > 1 else 0.0


def _are_days(finite: Array, low: float, high: float) -> bool:
    """Whether numbers are days, less than 9 s apart, and not seconds of a clock that is as fine."""
    return bool(finite.size > 1 and low < finite[0] < high and 0 < _step(finite) < 1e-4)


def _guess(first: float, ahead: Array, name: str, words: tuple[str, ...]) -> float:
    """Return the seconds of one count of a column without a unit."""
    good, step = ahead[np.isfinite(ahead)], _step(ahead)
    for scale in (1.0, 1e-3, 1e-6, 1e-9):
        if EPOCH[0] < first * scale < EPOCH[1] and step * scale <= RARE and words not in spellings.TICKS:
            return scale
    if words in spellings.TICKS or (step >= COARSE and bool((good == np.round(good)).all())):
        raise UnknownTimeError("no-time-unit", name=name, step=step)
    return 1.0


def _dates(values: NDArray[Any], name: str) -> tuple[NDArray[Any], str]:
    """Return dates or times of day, and what is to be said of the order of day and month.

    They are as ISO 8601 writes them, or day.month.year, or with slashes in an order that the values show; minutes and
    seconds alone; with a point or a comma in seconds, and AM or PM.
    """
    import pandas

    texts = pandas.Series([None if value is None else str(value).strip() for value in values.tolist()])
    texts = texts.replace({"": None, "nan": None})
    texts = texts.str.replace(r"^(\d{4})/(\d\d)/(\d\d)", r"\1-\2-\3", regex=True)
    texts = texts.str.replace(r"^(\d\d?)\.(\d\d?)\.(\d{4})(?=\D|$)", _day_first, regex=True)
    texts, order = _without_slashes(texts, name)
    texts = texts.str.replace(r"(?<=:\d\d),(?=\d)", ".", regex=True)
    if texts.str.fullmatch(r"\d+:\d\d\.\d+").any():
        texts = texts.str.replace(r"^(\d+:\d\d(\.\d+)?)$", r"00:\1", regex=True)
    texts = texts.str.replace(r"(?<!\d)(0?[1-9]|1[0-2])(:\d\d[\d:.]*) ?([AP])M$", _of_24_hours, regex=True, flags=re.I)
    with suppress(ValueError, TypeError, OverflowError):
        return np.asarray(pandas.to_datetime(texts, format="ISO8601", utc=True).dt.tz_localize(None).to_numpy()), order
    with suppress(ValueError, TypeError, OverflowError):
        return np.asarray(pandas.to_timedelta(texts).to_numpy()), order
    raise UnknownTimeError("not-a-time", name=name, value=values[0])


def _without_slashes(texts: pandas.Series, name: str) -> tuple[pandas.Series, str]:
    """Return dates like 12/31/2026 as ISO 8601 writes them, and in words which number is the day."""
    found = texts.str.extract(_SLASHED).dropna().astype(int)
    if found.empty:
        return texts, ""
    above = [bool((found[k] > 12).any()) for k in (0, 1)]
    if above[0] == above[1]:
        why = "both the first and the second number are above 12 in some row" if above[0] else "neither is above 12"
        raise UnknownTimeError("day-or-month", name=name, value=texts[found.index[0]], why=why)
    order = f", {'day/month' if above[0] else 'month/day'}/year, as the numbers above 12 show"
    return texts.str.replace(_SLASHED, _day_first if above[0] else _month_first, regex=True), order


def _day_first(date: re.Match[str]) -> str:
    return f"{date[3]}-{date[2]:0>2}-{date[1]:0>2}"


def _month_first(date: re.Match[str]) -> str:
    return f"{date[3]}-{date[1]:0>2}-{date[2]:0>2}"


def _of_24_hours(time: re.Match[str]) -> str:
    hour, rest, half = time.groups()
    return f"{int(hour) % 12 + 12 * (half in 'Pp'):02}{rest}"


def _dated(values: NDArray[Any], name: str, order: str) -> Clock:
    if values.dtype.kind == "m" or not values.size or np.isnat(values[0]):
        times, over = counted_on(seconds(values), PERIODS)
        is_day = values.size and values.dtype.kind == "m" and not np.isnat(values[0])
        start = float(values[0] / np.timedelta64(1, "s")) if is_day else None
        return Clock(times, start, (f"time: column {name!r}, from its first{over}",))
    start = float((values[0].astype("M8[ns]") - np.datetime64(0, "ns")) / np.timedelta64(1, "s"))
    return Clock(seconds(values), start, (f"time: column {name!r}, dates{order}",))


def seconds(times: ArrayLike) -> Array:
    """Return times as float seconds; dates and durations count from the first."""
    values = as_plain(times, "time")
    if values.dtype.kind in "mM" and values.ndim == 1 and values.size:
        return np.where(np.isnat(values), np.nan, (values - values[0]) / np.timedelta64(1, "s"))
    return as_floats(times, "time")


def _of_counter(table: Table, name: str, rate: float) -> Clock:
    """Return times of numbers of samples; a counter that starts anew is counted on."""
    ticks, over = counted_on(table.numbers(name), {one: str(int(one)) for one in BITS})
    finite = ticks[np.isfinite(ticks)]
    note = f"time: column {name!r} at {rate:g} samples a second{over}"
    return Clock((ticks - (finite[0] if finite.size else 0)) / rate, None, (note,))
