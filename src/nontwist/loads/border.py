"""What callers give of loads, checked."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np

from ..geometry.arrays import Array, as_array
from ..geometry.values import among, as_list, shown


def increasing(t: Array) -> float:
    """Return the smallest gap of the times of a table; a ValueError where they do not increase."""
    if t.size < 2:
        raise ValueError(f"a table needs at least 2 times, got {t.size}")
    if (gaps := np.diff(t)).min() <= 0:
        k = int(np.argmax(gaps <= 0))
        raise ValueError(f"times must increase, but times[{k + 1}] = {t[k + 1]:g} follows times[{k}] = {t[k]:g}")
    return float(gaps.min())


def breaks(times: Iterable[float]) -> tuple[float, ...]:
    """Return breakpoints that a caller gives, as a tuple."""
    return tuple(as_array(as_list(times, "breakpoints"), "breakpoints", (None,)).tolist())


def frame_of(frame: Literal["body", "space"]) -> Literal["body", "space"]:
    """Return a frame; a ValueError where it is none."""
    if not among(frame, ("body", "space")):
        raise ValueError(f"frame must be 'body' or 'space', got {shown(frame)}")
    return frame
