"""The time of a recording: which columns tell it, in what unit, from when on.

A column is the time by its name, by its name and a unit, by a unit alone, or as it holds dates, in this order; several
must agree. Numbers without a unit are dates where they lie in our time as one row of `SINCE` counts, else seconds. A
clock that starts again is counted on where its period is known: counters of 8 to 32 bits, hours, days, weeks of GPS.
"""

from __future__ import annotations

import re
import warnings
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, InputWarning
from ..geometry.arrays import Array, as_floats, as_plain
from ..geometry.values import counted
from ..units import TIME, known, split_unit
from .headers import GYROSCOPE, sensors
from .options import ReadOptions
from .table import Table, listed, number, place

EPOCH = (3e8, 4.2e9)  # s since 1970 that are taken for dates: 1979 to 2103
RARE = 60.0  # s between samples; what lies further apart as seconds since 1970 are ticks
RARE_US = 1.0  # s between samples that µs since 1970 count; what lies further apart are ns since a device started
MONTHS = "janfebmaraprmayjunjulaugsepoctnovdec"
FINE = 1e-4  # days between samples at most, else they are no days but seconds of a clock that is as fine
WIDE = 1.5  # of the usual step of a counter: beyond it samples are lost
COARSE = 5.0  # numbers without a unit that are as far apart are not seconds, but that a gyroscope may tell it
# Words of times, and words that may be beside them; words of numbers of samples.
TIMES = {"t", "time", "timestamp", "stamp", "datetime", "seconds", "secs", "sec", "epoch", "epoc", "datenum"}
TIMES |= {"zeit", "temps", "tiempo", "tempo", "tijd"}
BESIDE_TIME = {"elapsed", "unix", "utc", "cal", "sample", "header", "field", "system", "sensor", "fine", "local"}
BESIDE_TIME |= {"date", "logging", "gps", "gnss", "excel", "serial", "matlab", "day"}
LIKE_TIME = "time|stamp|date|clock|zeit|datum|temps|heure|tiempo|hora|tijd"
COUNTERS = {"packet", "counter", "packetcounter", "frame", "frames", "sample", "samples", "index", "number", "count"}
TICKS = {("sample", "time", "fine")}  # whose length depends on the device
# Parts of a time that may be in columns of their own, beside units of time.
PARTS = {"date": "date", "datum": "date", "time": "time", "zeit": "time", "uhrzeit": "time"}
PARTS |= {"year": "year", "month": "month"}
SINCE = {  # how dates are counted: s of one count, and how many are before 1970
    **{f"{unit} since 1970": (TIME[unit], 0.0) for unit in ("s", "ms", "us")},
    "ticks of .NET": (1e-7, 621_355_968e9),  # before ns: as such, they would be dates of 1990
    "ns since 1970": (1e-9, 0.0),
    "days of a spreadsheet": (TIME["day"], 25_569.0),
    "days of MATLAB": (TIME["day"], 719_529.0),
    "Julian days": (TIME["day"], 2_440_587.5),
}
BITS = {2.0**n: str(2**n) for n in (8, 16, 24, 31, 32)}
PERIODS = {60.0: "a minute", 3600.0: "an hour", 43200.0: "half a day", 86400.0: "a day", 604800.0: "a week of GPS"}
PERIODS |= {2.0**n * tick: f"{2**n} {unit}" for n in (16, 31, 32) for tick, unit in ((1e-3, "ms"), (1e-6, "µs"))}
NEW, MOST = 0.1, 25.0  # of a period, and of the median step, at most, that a step over its end may last
PAIRS = [["date", "time"], ["s", "ns"], ["s", "us"], ["s", "ms"]]  # of columns that tell a time
NOT_UNDERSTOOD = ("no-time-unit", "not-a-time", "day-or-month")  # of a column that may be no time


@dataclass(frozen=True)
class Clock:
    """Times, s; `start` is what they count from, s since 1970, where the recording tells dates; `notes` in words."""

    time: Array | None = None
    start: float | None = None
    notes: tuple[str, ...] = ()
    has_unit: bool = True


def clock(table: Table, how: ReadOptions) -> Clock:
    """Return the time of a table; an InputError where it is not understood, or may be that of several columns."""
    name, rate, notes = how.time_column, how.rate, list[str]()
    if name is not None:
        pairs = {" and ".join(h): one for h, one in filter(None, (_pair(table, one) for one in _groups(table)))}
        if name not in pairs:
            table.require(name)
        if rate is not None and not _counts(name):
            raise InputError("rate-and-time", name=name)
        if name in pairs:
            how.require_without("time_unit", "the columns state theirs")
            return pairs[name]
        return read_times(table, name, how.time_unit) if rate is None else _of_counter(table, name, rate)
    if rate is not None:
        how.require_without("time_unit", "a rate gives the times")
    found = _found(table, how, notes)
    return replace(found, notes=(*notes, *found.notes))


def _found(table: Table, how: ReadOptions, notes: list[str]) -> Clock:
    """Return the time by the headers; `notes` tell what was not taken for it."""
    rate, groups, unknown = how.rate, _groups(table), None
    headers, pair = next(filter(None, (_pair(table, parts) for parts in groups)), ((), Clock()))
    read = {" and ".join(headers): pair} if headers else {}
    ranks = {h: _rank(h) for h in table.headers if h not in headers}
    empty = {h for h in ranks if not _has_values(table.columns[h])}
    notes += [f"time: the column {h!r} is empty" for h in ranks if ranks[h] == 0 and h in empty]

    def tried(*wanted: int) -> Iterator[tuple[str, Clock | ValueError]]:
        for h in (h for h, rank in ranks.items() if rank in wanted and h not in empty):
            try:
                yield h, read_times(table, h, how.time_unit)
            except ValueError as error:
                yield h, error

    for h, one in tried(0):
        if isinstance(one, Clock):
            read[h] = one
        elif getattr(one, "code", "") in NOT_UNDERSTOOD:
            notes.append(not_used(one))
            unknown = unknown or one
        elif rate is None:
            raise one
        else:
            notes.append(ignored(f"the column {h!r}", None))
    if len(read) > 1:  # what does not change is no time
        read = {h: one for h, one in read.items() if np.diff(np.asarray(one.time)).any()} or read
    for rank in (1, 2):
        stated = {} if read else {h: one for h, one in tried(rank) if isinstance(one, Clock) and _increases(one)}
        read = read or (stated if _agree(stated) else {})
        read = read or next(filter(None, (_calendar(table, parts) for parts in groups)), {})
    counter = next(filter(_counts, table.headers), None)
    if rate is not None:
        notes += [ignored(f"the column {h!r}", one.time) for h, one in read.items()]
        return _of_counter(table, counter, rate)
    if read:
        if not any(h in table.columns and table.columns[h].dtype.kind in "iuf" for h in read):
            how.require_without("time_unit", "the times state theirs")
        if not _agree(read):
            raise InputError("several-times", names=listed(read))
        return next(iter(read.values()))
    if unknown is not None:
        raise unknown
    if counter is not None:
        notes.append(f"time: none; the column {counter!r} numbers the samples, a rate makes times of it")
        _warn_of_lost(table, counter)
    for h, one in tried(1, 2, 3):
        if isinstance(one, Clock) and one.start is not None and _increases(one):
            return one
        may_be = f"time: the column {h!r} may hold times; name it as the time column to use it"
        notes.append(may_be if isinstance(one, Clock) else not_used(one))
    how.require_without("time_unit", "no column of times is found")
    return Clock(notes=() if notes else ("time: none; a rate gives times",))


def _warn_of_lost(table: Table, name: str) -> None:
    """Warn of samples that a column numbers and a file without times lacks."""
    ticks = counted_on(table.numbers(name), BITS)[0] if table.columns[name].dtype.kind in "iuf" else np.empty(0)
    rows = np.flatnonzero(np.isfinite(ticks))
    steps = np.diff(ticks[rows])
    usual = float(np.median(steps)) if steps.size and steps.min() > 0 else np.inf
    wide = np.flatnonzero(steps > WIDE * usual)
    if wide.size:
        samples = counted(round(float((steps[wide] / usual - 1).sum())), "sample")
        first = place(int(rows[wide[0] + 1]), table.lines)
        warnings.warn(InputWarning("lost-samples", name=name, samples=samples, place=first), stacklevel=2)


def ignored(what: str, time: Array | None) -> str:
    """Return the note on times that a rate replaces, with the average rate that they tell."""
    finite = np.array([]) if time is None else time[np.isfinite(time)]
    span = np.ptp(finite) if finite.size else 0.0
    average = f", {(finite.size - 1) / span:.4g} samples a second on average," if span > 0 else ""
    return f"time: {what}{average} is ignored, as a rate is given"


def not_used(error: ValueError) -> str:
    """Return the note on a column that is not understood: what is wrong, without the options that would help."""
    return f"time: not used: {str(error).partition('; ')[0]}"


def words_of(header: str) -> tuple[list[str], str | None]:
    """Return the words of a header in small letters, and its unit, in brackets or as its last word."""
    name, unit = split_unit(header)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = [word for word in re.split(r"[^a-zµμ]+", spaced.lower()) if word]
    beside = BESIDE_TIME - {"elapsed"}
    if unit is None and len(words) > 1 and known(words[-1], TIME) and words[-2] not in beside:
        unit = words.pop()
    return words, unit


def _rank(header: str) -> int | None:
    """Return how surely a header is of a time: 0 by its name, 1 by name and unit, 2 by a unit, 3 as it may be one."""
    words, unit = words_of(re.sub(r"^.*\.(?=\D)", "", header))  # in a structure, as data.time
    if re.search("deg|[°℃]", (unit or "").lower()) or re.search(r"(?i)\bt_?\d\d$", header):
        # a temperature, an angle, or T00, an element of a matrix
        return None
    all_words, seconds = set(words), known(unit, TIME)
    is_told = unit is None or seconds or unit.lower() in ("txt", "text", "iso", "utc") or len(words) == 1
    is_named = TIMES & all_words or ("elapsed" in words and seconds)
    if is_named and all_words <= TIMES | (BESIDE_TIME if is_told else set()):
        return 0
    if re.search(LIKE_TIME, header.lower()):
        return 1 if seconds else 3
    name, unit = split_unit(header)
    return 2 if known(unit or name, TIME) else None


def _counts(header: str) -> bool:
    words, unit = words_of(header)
    return bool(words) and unit is None and set(words) <= COUNTERS


def _has_values(values: NDArray[Any]) -> bool:
    return values.size > 0 and not (values.dtype.kind == "f" and not np.isfinite(values).any())


def _increases(found: Clock) -> bool:
    time = np.asarray(found.time)
    steps = np.diff(time[np.isfinite(time)])
    return bool((steps >= 0).all() and (steps > 0).any())


def _agree(read: dict[str, Clock]) -> bool:
    """Whether columns tell the same intervals as the first, within a hundredth of one."""
    times = [np.asarray(one.time) for one in read.values()]
    for other in times[1:]:
        if len(other) != len(times[0]):
            return False
        good = np.isfinite(times[0]) & np.isfinite(other)
        a, b = (one[good] - one[good][:1] for one in (times[0], other))
        if a.size < 2 or abs(a - b).max() > 0.01 * np.median(abs(np.diff(a))) * max(1.0, a.size / 100):
            return False
    return True


def _groups(table: Table) -> list[dict[str, str]]:
    """Return the headers that differ in their last word, by the part of a time that it is: ``date``, ``ns``."""
    groups: dict[tuple[str, ...], dict[str, str]] = defaultdict(dict)
    for h in table.headers:
        *before, last = re.findall(r"[a-zµ]+", h.lower()) or [""]
        if _has_values(table.columns[h]):
            groups[tuple(before)][PARTS.get(last) or known(last, TIME) or ""] = h
    return list(groups.values())


def _pair(table: Table, parts: dict[str, str]) -> tuple[list[str], Clock] | None:
    """Return the headers and the time of a date and a time of day, or of seconds and a smaller unit."""
    for pair in PAIRS:
        headers = [parts[one] for one in pair if one in parts]
        columns = [table.columns[h] for h in headers]
        if len(headers) < 2:
            continue
        note = f"time: columns {headers[0]!r} and {headers[1]!r}"
        if pair[0] == "date" and [":" in str(one[:1]) for one in columns] == [False, True]:
            texts = np.array([" ".join(map(str, row)) for row in zip(*columns, strict=True)], dtype=object)
            return headers, replace(read_times(Table({headers[0]: texts}), headers[0], None), notes=(note,))
        if pair[0] == "s" and all(one.dtype.kind in "fiu" for one in columns):
            (whole, rest), unit = map(table.numbers, headers), TIME[pair[1]]
            if np.nanmax(whole % 1) == 0 and np.nanmax(rest) * unit <= 1:
                k = int(np.isfinite(whole + rest).argmax())
                ahead, start = (whole - whole[k]) + (rest - rest[k]) * unit, float(whole[k] + rest[k] * unit)
                is_date = EPOCH[0] < start < EPOCH[1]
                note += f", s and {pair[1]}"
                return headers, Clock(ahead if is_date else ahead + start, start if is_date else None, (note,))
    return None


def _calendar(table: Table, parts: dict[str, str]) -> dict[str, Clock]:
    """Return the time of columns of years, months and days, with hours and less beside them, where it increases."""
    import pandas

    used = {one: h for one, h in parts.items() if one in ("year", "month", *TIME)}
    with suppress(ValueError, TypeError):  # without years, months or days
        columns = {one.replace("min", "m"): table.columns[h] for one, h in used.items()}
        dates = pandas.to_datetime(pandas.DataFrame(columns), errors="coerce").to_numpy()
        found = _dated(dates, " ".join(used.values()))
        return {"dates": found} if found.start is not None and _increases(found) else {}
    return {}


def counted_on(ticks: Array, periods: Mapping[float, str]) -> tuple[Array, str]:
    """Return a clock of one of these periods without its starts again, and what is to be said of them."""
    is_finite = np.isfinite(ticks)
    finite = ticks[is_finite]
    back = np.diff(finite)
    if not (back < 0).any():
        return ticks, ""
    step = float(np.median(back[back > 0])) if (back > 0).any() else 0.0
    for period in sorted(periods):
        over = back < -max((1 - NEW) * period, period - MOST * step)
        if np.ptp(finite) < period and over.any() and over.sum() >= (back < -period / 2).sum():
            ticks = ticks.copy()
            ticks[is_finite] += period * np.append(0, np.cumsum(over))
            return ticks, f", counted on where it starts again after {periods[period]}"
    return ticks, ""


def read_times(table: Table, name: str, unit: str | None) -> Clock:
    """Return the times of one column."""
    values = np.asarray(table.columns[name])
    words, stated = words_of(name)
    stated = name if known(name, TIME) else stated
    is_date = values.dtype.kind in "mM"
    is_text = values.dtype.kind in "OUST" and next((number(v) is None for v in values.tolist() if v is not None), True)
    meant = stated if unit is None else unit
    seconds = TIME.get(known(meant, TIME) or "", number(meant))  # none of what a header has else in brackets
    scale = seconds if seconds is not None and 0 < seconds < np.inf else None
    if unit and scale is None:
        raise InputError("time-unit", unit=unit, name=name, units=", ".join(TIME))
    if is_date or is_text:
        return _dated(values, name) if is_date else _dates(values, name)
    if unit is not None and known(stated, TIME) not in (None, known(unit, TIME)):
        raise InputError("time-unit-stated", name=name, stated=known(stated, TIME), unit=unit)
    ticks = table.numbers(name)
    finite = ticks[np.isfinite(ticks)]
    first = float(finite[0]) if finite.size else 0.0
    step = float(np.median(abs(np.diff(finite)))) if finite.size > 1 else 0.0
    is_exact = values.dtype.kind in "iu" and values.size
    ahead = (values.astype(np.int64) - np.int64(values[0])).astype(float) if is_exact else ticks - first
    date, zero, has_unit = None, 0.0, scale is not None
    if scale is None:
        is_tick = tuple(words) in TICKS
        date = None if is_tick else next((one for one in SINCE if _is_date(first, step, *SINCE[one])), None)
        is_coarse = step >= COARSE and ((finite == np.round(finite)).all() or not sensors(table.headers, GYROSCOPE))
        if date is None and (is_tick or is_coarse):
            raise InputError("no-time-unit", name=name, step=step)
        if date is None and stated:
            raise InputError("time-unit", unit=stated, name=name, units=", ".join(TIME))
        scale, zero = (1.0, 0.0) if date is None else SINCE[date]
    symbol = next((symbol for symbol, one in TIME.items() if one == scale), f"counts of {scale:g} s")
    periods = BITS  # where a clock begins at its least, recordings may follow each other
    if first - finite.min(initial=first) > step:
        periods = periods | {one / scale: told for one, told in PERIODS.items()}
    ticks, over = counted_on(ticks, periods)
    ahead = ticks - first if over else ahead
    start = (first - zero) * scale
    if EPOCH[0] < start < EPOCH[1]:
        return Clock(ahead * scale, start, (f"time: column {name!r}, {date or f'{symbol} since 1970'}{over}",))
    how = "" if has_unit else ", as nothing else is stated"
    return Clock(ticks * scale, None, (f"time: column {name!r}, {symbol}{how}{over}",), has_unit)


def _is_date(first: float, step: float, scale: float, zero: float) -> bool:
    """Whether counts from `zero` are dates of our time, and as close as samples are."""
    is_close = 0 < step < FINE if scale == TIME["day"] else step * scale <= (RARE_US if scale == TIME["us"] else RARE)
    return EPOCH[0] < (first - zero) * scale < EPOCH[1] and is_close


def _dates(values: NDArray[Any], name: str) -> Clock:
    """Return the time of texts that are dates or times of day.

    They are as ISO 8601 writes them, or day.month.year, or with slashes in an order that the values show; minutes and
    seconds alone; with a point or a comma in seconds, and AM or PM.
    """
    import pandas

    texts = pandas.Series([None if value is None else str(value).strip() for value in values.tolist()])
    texts, order = texts.replace({"": None, "nan": None}), ""
    dates = texts.str.extract(r"^(\d\d?)/(\d\d?)/\d{4}(?=\D|$)").dropna().astype(int)
    if not dates.empty:
        day = [bool((dates[k] > 12).any()) for k in (0, 1)]
        if day[0] == day[1]:
            why = "both the first and the second number are above 12 in some row" if any(day) else "neither is above 12"
            raise InputError("day-or-month", name=name, value=texts[dates.index[0]], why=why)
        order = f", {'day/month' if day[0] else 'month/day'}/year, as the numbers above 12 show"
    for written, iso in (
        (r"^(\d{4}/\d\d/\d\d)/(?=\d)", r"\1 "),  # rosbag_to_csv
        (r"^(\d{4})/(\d\d)/(\d\d)", r"\1-\2-\3"),
        (r"^(\d\d?)-([A-Z][a-z]{2})-(\d{4})(?=\D|$)", _of_month),
        (r"^([12]\d{3})-(\d{3})(?=T)", lambda day: f"{date(int(day[1]), 1, 1) + timedelta(int(day[2]) - 1)}"),
        (r"^(\d\d?)\.(\d\d?)\.(\d{4})(?=\D|$)", r"\3-\2-\1"),
        (r"^(\d\d?)/(\d\d?)/(\d{4})(?=\D|$)", r"\3-\2-\1" if order.startswith(", day") else r"\3-\1-\2"),
        (r"(?<=:\d\d),(?=\d)", "."),
        (r"(?<!\d)(0?[1-9]|1[0-2])(:\d\d[\d:.]*) ?([AP])M$", _of_24_hours),
    ):
        texts = texts.str.replace(written, iso, regex=True, flags=re.IGNORECASE)
    if texts.str.fullmatch(r"\d+:\d\d\.\d+").any():
        texts = texts.str.replace(r"^(\d+:\d\d(\.\d+)?)$", r"00:\1", regex=True)
    is_duration = texts.str.contains(r"[:a-z]", case=False, na=True)  # not 1,000, which is 1 µs to pandas
    with suppress(ValueError, TypeError, OverflowError):
        dates = pandas.to_datetime(texts, format="ISO8601", utc=True).dt.tz_localize(None)
        return _dated(dates.to_numpy(), name, order)
    with suppress(ValueError, TypeError, OverflowError):
        if is_duration.all():
            return _dated(pandas.to_timedelta(texts).to_numpy(), name)
    others = values[~is_duration].tolist() or values.tolist()
    value = next((one for one in others if number(str(one).replace(",", ".")) is None), others[0])  # 1.000,5 before 0,5
    raise InputError("not-a-time", name=name, value=value)


def _of_month(day: re.Match[str]) -> str:
    return f"{day[3]}-{MONTHS.find(day[2].lower()) // 3 + 1:02}-{int(day[1]):02}"


def _of_24_hours(time: re.Match[str]) -> str:
    hour, rest, half = time.groups()
    return f"{int(hour) % 12 + 12 * (half in 'Pp'):02}{rest}"


def _dated(values: NDArray[Any], name: str, order: str = "") -> Clock:
    """Return the time of dates, or of durations as are times of day, from the first on."""
    ahead, start = seconds(values)
    times, over = counted_on(ahead, PERIODS if values.dtype.kind == "m" else {})
    told = f"dates{order}" if values.dtype.kind == "M" else f"from its first{over}"
    return Clock(times, start, (f"time: column {name!r}, {told}",))


def seconds(times: Any) -> tuple[Array, float | None]:
    """Return times as float seconds, by their unit if they have one, and what dates and durations count from.

    That is the first of them: s since 1970, or of the day.
    """
    values = as_plain(times, "time")
    if values.dtype.kind == "O" and values.ndim == 1 and values.size and isinstance(values[0], date):
        import pandas

        values = pandas.to_datetime(values, utc=True).tz_localize(None).to_numpy()
    if values.dtype.kind in "mM" and values.ndim == 1 and values.size:
        first = values[np.isnat(values).argmin()]
        ahead, start = (one / np.timedelta64(1, "s") for one in (values - first, first - np.array(0, values.dtype)))
        return np.where(np.isnat(values), np.nan, ahead), None if np.isnat(first) else float(start)
    unit = known(str(getattr(times, "attrs", {}).get("units", getattr(times, "unit", None))), TIME)
    return as_floats(times, "time") * TIME[unit or "s"], None


def _of_counter(table: Table, name: str | None, rate: float) -> Clock:
    """Return times of numbers of samples, of rows without a name; a counter that starts anew is counted on."""
    ticks, over = (np.arange(float(len(table))), "") if name is None else counted_on(table.numbers(name), BITS)
    finite = ticks[np.isfinite(ticks)]
    column = "" if name is None else f"column {name!r} at "
    note = f"time: {column}{rate:g} samples a second{over}"
    return Clock((ticks - (finite[0] if finite.size else 0)) / rate, None, (note,))
