"""The values of a time column as seconds: numbers with a unit, dates, counters that start anew."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, as_floats, as_plain
from .headers import split_unit
from .places import RowError

if TYPE_CHECKING:
    import pandas

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
SPELLED = {"sec": "s", "secs": "s", "seconds": "s", "second": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms"}
SPELLED |= {"usec": "us", "micros": "us", "microseconds": "us", "nsec": "ns", "nanos": "ns", "nanoseconds": "ns"}
SPELLED |= {"minutes": "min", "hours": "h", "μs": "us"}
QUALIFIERS = {
    "elapsed",
    "unix",
    "utc",
    "cal",
    "sample",
    "header",
    "field",
    "system",
    "sensor",
    "fine",
    "local",
    "date",
    "logging",
}
UNSTATED = {("sample", "time", "fine")}  # ticks whose length depends on the device
EPOCH = (3e8, 4.2e9)  # s since 1970 that are taken for dates: 1979 to 2103
RARE = 60.0  # s between samples; what lies further apart as seconds since 1970 are ticks
MONTHS = 12
COARSE = 5.0  # whole numbers without a unit that are as far apart are no seconds


class UnknownTimeError(ValueError):
    """A time column cannot be understood without being told its unit, or holds no times."""


@dataclass(frozen=True)
class Clock:
    """Times, s; `start` is what they count from, s since 1970, where the recording tells dates; notes in words."""

    time: Array | None
    start: float | None
    notes: list[str]


def words_of(header: str) -> tuple[list[str], str | None]:
    """Return the words of a header in small letters, and its unit, in brackets or as its last word."""
    name, unit = split_unit(header)
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = [word for word in re.split(r"[^a-zµμ]+", spaced.lower()) if word]
    if unit is None and len(words) > 1 and known_unit(words[-1]) and words[-2] not in QUALIFIERS | {"header"}:
        unit = words.pop()
    return words, unit


def known_unit(text: str) -> str | None:
    """Return the symbol of a unit of time, None where it is none."""
    text = text.strip().lower()
    return text if text in UNITS else SPELLED.get(text)


def counted_on(ticks: Array, sizes: tuple[int, ...]) -> tuple[Array, str]:
    """Return a counter of one of these sizes without its overflows, and what is to be said of them."""
    finite = np.isfinite(ticks)
    step = np.diff(ticks[finite])
    for size in sizes:
        over = step < -0.9 * size
        if over.any() and ticks[finite].min() >= 0 and ticks[finite].max() < size:
            ticks = ticks.copy()
            ticks[finite] += size * np.append(0, np.cumsum(over))
            return ticks, f", counted on where it starts again at {size}"
    return ticks, ""


def read_times(columns: Mapping[str, NDArray[np.generic]], name: str, unit: str | None) -> Clock:
    """Return the times of one column."""
    values = np.asarray(columns[name])
    if values.dtype.kind in "mM":
        return _dated(values, name, "")
    words, stated = words_of(name)
    given = unit if unit is not None else stated
    if values.dtype.kind in "OUST" and not _numeric(values):
        dates, order = _dates(values, name)
        return _dated(dates, name, order)
    scale = _scale(given, name, stated is None or unit is not None)
    if unit is not None and stated is not None and known_unit(stated) not in (None, known_unit(unit)):
        raise ValueError(
            f"the column {name!r} states {known_unit(stated)}, but --time-unit (time_unit=) says {unit}; omit the "
            "option, or rename the column"
        )
    if values.dtype.kind in "iu" and values.size:
        first = float(values[0])
        ahead, over = counted_on(values.astype(float), (2**32,))
        ahead = (values.astype(np.int64) - np.int64(values[0])).astype(float) if not over else ahead - first
    else:
        first, ahead, over = 0.0, numbers(columns, name), ""
        good = ahead[np.isfinite(ahead)]
        if good.size and abs(good[0]) > EPOCH[0]:
            first, ahead = float(good[0]), ahead - good[0]
    how = "" if scale is not None else ", as nothing else is stated"
    if scale is None:
        scale = _guess(first, ahead, name, tuple(words))
    symbol = next((symbol for symbol, one in UNITS.items() if one == scale), f"counts of {scale:g} s")
    if EPOCH[0] < first * scale < EPOCH[1]:
        return Clock(ahead * scale, first * scale, [f"time: column {name!r}, {symbol} since 1970"])
    return Clock((ahead + first) * scale, None, [f"time: column {name!r}, {symbol}{how}{over}"])


def _scale(given: str | None, name: str, strict: bool) -> float | None:
    """Return the seconds of a unit; None where there is none, or its header has something else in brackets."""
    if given is None or not given:
        return None
    known = known_unit(given)
    if known is not None:
        return UNITS[known]
    try:
        seconds = float(given)
    except ValueError:
        seconds = 0.0
    if seconds > 0:
        return seconds
    raise ValueError(
        f"unknown unit of time {given!r} in the column {name!r}; known are {', '.join(UNITS)}, or the seconds of one "
        "count: --time-unit (time_unit=)"
    )


def _guess(first: float, ahead: Array, name: str, words: tuple[str, ...]) -> float:
    """Return the seconds of one count of a column without a unit."""
    good = ahead[np.isfinite(ahead)]
    step = float(np.median(abs(np.diff(good)))) if good.size > 1 else 0.0
    for scale in (1.0, 1e-3, 1e-6, 1e-9):
        if EPOCH[0] < first * scale < EPOCH[1] and step * scale <= RARE and words not in UNSTATED:
            return scale
    whole = bool((good == np.round(good)).all()) and step >= COARSE
    if whole or words in UNSTATED:
        raise UnknownTimeError(
            f"the column {name!r} does not state its unit, and its samples are {step:g} apart; use --time-unit "
            "(time_unit=) s, ms, us, ns, or the seconds of one count"
        )
    return 1.0


def _numeric(values: NDArray[np.generic]) -> bool:
    return next((number(value) is not None for value in values.tolist() if value is not None), False)


def _dates(values: NDArray[np.generic], name: str) -> tuple[NDArray[np.generic], str]:
    """Return dates and times of day, and what is to be said of the order of day and month.

    They are as ISO 8601 writes them, or day.month.year, or with slashes in an order that the values show; with a point
    or a comma in seconds, and AM or PM.
    """
    import pandas

    texts = pandas.Series([None if value is None else str(value).strip() for value in values.tolist()])
    texts = texts.str.replace(r"^(\d{4})/(\d\d)/(\d\d)", r"\1-\2-\3", regex=True).replace({"": None, "nan": None})
    texts = texts.str.replace(r"^(\d\d?)\.(\d\d?)\.(\d{4})(?=\D|$)", _day_first, regex=True)
    texts, order = _without_slashes(texts, name)
    texts = texts.str.replace(r"(?<=:\d\d),(?=\d)", ".", regex=True)
    texts = texts.str.replace(r"(?<!\d)(0?[1-9]|1[0-2])(:\d\d[\d:.]*) ?([AP])M$", _of_24_hours, regex=True, flags=re.I)
    with suppress(ValueError, TypeError, OverflowError):
        return np.asarray(pandas.to_datetime(texts, format="ISO8601", utc=True).dt.tz_localize(None).to_numpy()), order
    with suppress(ValueError, TypeError, OverflowError):
        return np.asarray(pandas.to_timedelta(texts).to_numpy()), order
    raise UnknownTimeError(
        f"the column {name!r} holds {values[0]!r}, which is neither a number nor a time like 2026-01-31T12:00:00.25; "
        "name another with --time-column (time_column=), or give --rate HZ (rate=)"
    )


def _without_slashes(texts: pandas.Series, name: str) -> tuple[pandas.Series, str]:
    """Return dates like 12/31/2026 as ISO 8601 writes them, and in words which number is the day.

    A ValueError is raised where no number is above 12, so that either may be, or numbers in both places are.
    """
    slashed = r"^(\d\d?)/(\d\d?)/(\d{4})(?=\D|$)"
    found = texts.str.extract(slashed).dropna().astype(int)
    if found.empty:
        return texts, ""
    above = [bool((found[k] > MONTHS).any()) for k in (0, 1)]
    if above[0] == above[1]:
        why = "both the first and the second number are above 12 in some row" if above[0] else "neither is above 12"
        raise UnknownTimeError(
            f"the column {name!r} holds {texts[found.index[0]]!r}, where day and month cannot be distinguished: {why}; "
            "write dates like 2026-01-31T12:00:00.25, name another column with --time-column (time_column=), or give "
            "--rate HZ (rate=)"
        )
    order = f", {'day/month' if above[0] else 'month/day'}/year, as the numbers above 12 show"
    return texts.str.replace(slashed, _day_first if above[0] else _month_first, regex=True), order


def _day_first(date: re.Match[str]) -> str:
    day, month, year = date.groups()
    return f"{year}-{month:0>2}-{day:0>2}"


def _month_first(date: re.Match[str]) -> str:
    month, day, year = date.groups()
    return f"{year}-{month:0>2}-{day:0>2}"


def _of_24_hours(time: re.Match[str]) -> str:
    hour, rest, half = time.groups()
    return f"{int(hour) % 12 + 12 * (half in 'Pp'):02}{rest}"


def _dated(values: NDArray[np.generic], name: str, order: str) -> Clock:
    time = seconds(values)
    if values.dtype.kind == "m" or not values.size or np.isnat(values[0]):
        return Clock(time, None, [f"time: column {name!r}, from its first"])
    start = float((values[0].astype("M8[ns]") - np.datetime64(0, "ns")) / np.timedelta64(1, "s"))
    return Clock(time, start, [f"time: column {name!r}, dates{order}"])


def numbers(columns: Mapping[str, NDArray[np.generic]], name: str) -> Array:
    """Return a column as floats; a ValueError names the row that holds something else."""
    values = np.asarray(columns[name])
    if values.dtype.kind in "cmM":
        return as_floats(values, f"the column {name!r}")
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError):
        bad = [number(value) is None for value in values.tolist()]
    worse = [found and number(str(value).replace(",", ".")) is None for found, value in zip(bad, values, strict=True)]
    k = int(np.argmax(worse if any(worse) else bad))  # beside decimal commas, what is no number at all
    raise RowError(f"the column {name!r} holds {values[k]!r} in", k, ", which is not a number; correct or delete it")


def number(value: object) -> float | None:
    """Return `value` as a float, or None if it is not a number."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def seconds(times: ArrayLike) -> Array:
    """Return times as float seconds; dates and durations count from the first."""
    values = as_plain(times, "time")
    if values.dtype.kind in "mM" and values.ndim == 1 and values.size:
        durations = values - values[0]
        return np.where(np.isnat(values), np.nan, durations / np.timedelta64(1, "s"))
    return as_floats(times, "time")
