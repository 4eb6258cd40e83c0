"""What a march carries from run to run, so that a run that is continued has the bits of one that was never stopped."""

from __future__ import annotations

import numpy as np

from ..engine.records import BODY, STATE
from ..geometry.arrays import Array
from .compiled import Compiled

EPS, SAME = 2.0**-52, 1e-12


def factors(scheme: Compiled, bodies: Array, unit: float, size: int) -> Array:
    """Return what `size` carried numbers are multiplied by to have the units of the caller, (m or 1, size)."""
    found = np.ones((len(bodies), size))
    moment = bodies[:, BODY.unit, None]
    if scheme.is_director_scheme:
        found[:, STATE.s :] = 1 / unit
    else:
        found[:, STATE.s : STATE.c], found[:, STATE.auxiliary :] = moment * unit, moment
    found[:, STATE.c : STATE.auxiliary] = 1.0
    if (more := size - STATE.size) > 0:  # increments of the momentum, and of directions
        found[:, STATE.size : STATE.size + more // 2], found[:, STATE.size + more // 2 :] = moment * unit, 1.0
    return found


def is_start(scheme: Compiled, carried: Array, states: Array) -> bool:
    """Whether carried numbers, in units of the march, belong to the states that a march starts from."""
    sign = np.where((carried[:, :4] * states[:, :4]).sum(1) < 0, -1.0, 1.0)[:, None]
    apart = [abs(sign * carried[:, :4] - states[:, :4]).max()]
    apart += [_apart(carried, states, slice(STATE.s, STATE.compensation))]
    if scheme.is_director_scheme:
        apart += [_apart(carried, states, slice(STATE.auxiliary, STATE.size))]
    apart += [abs(carried[:, STATE.c : STATE.auxiliary]).max() * SAME / (4 * EPS)]
    return not max(apart) > SAME


def _apart(a: Array, b: Array, part: slice) -> float:
    size = abs(b[:, STATE.s : STATE.compensation]).max()
    return float(abs(a[:, part] - b[:, part]).max() / size) if size > 0 else float(abs(a[:, part]).max())
