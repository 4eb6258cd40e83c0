"""From an `Ensemble` through the march in lanes to an `Outcome`: frames, loads at the nodes, blocks in threads.

Which form the step of a member takes, and the frame that it is written in, depend on that member alone; members of one
form march together.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..loads import Load
from ..models.stack import SystemStack
from .base import Status
from .composition import fractions, nodes
from .ensemble import COLUMNS, Ensemble, Outcome, in_threads, nothing, progress
from .marching import BLOCK

ROUND_OFF = 16 * float(np.finfo(np.float64).eps)
LARGEST = 1024  # members of a block


def march(ensemble: Ensemble, order: int, threads: int, director_scheme: bool) -> Outcome:
    """March with the composition of the given order, of the director scheme or of lie-midpoint.

    Loads must not be functions of the state, but for damping.
    """
    from . import lane_kernel
    from .lane_arrays import DIRECTOR_STATE, HEAVY, LANES, PUSHED, STATE, STEADY, SUMS

    kernel: Any = lane_kernel
    gamma, middles, m = fractions(order), nodes(order), len(ensemble)
    out = nothing(ensemble, director_scheme)
    bodies, own_kinds = bodies_of(ensemble.systems, ensemble.load)
    if director_scheme:
        own_kinds = np.where(own_kinds == HEAVY, own_kinds, PUSHED if ensemble.load.terms else STEADY)
    kinds = np.broadcast_to(own_kinds, m)
    sequence = np.argsort(kinds, kind="stable")
    state = np.empty((m, DIRECTOR_STATE if director_scheme else STATE))
    sums = np.zeros((m if ensemble.watched else 0, SUMS))
    kernel.enter(out.quaternion, out.velocity, out.normal, bodies, ensemble.systems.axis is not None, state)
    whole, done, size = max(1, BLOCK // len(middles)), 0, int(np.clip(-(-m // (4 * threads)), LANES, LARGEST))
    report = progress(ensemble, -(-ensemble.steps // whole))
    for first in range(0, ensemble.steps, whole):
        last = min(first + whole, ensemble.steps)
        try:
            loads = _at_nodes(ensemble.load, ensemble.nodes(first, last, middles))
        except ValueError as error:
            if first == 0:
                raise
            return _broken_off(out, sums, first, done + 1, str(error))
        grid = (ensemble.step, gamma, ensemble.stored, first, last - first, done)
        members, carried = (sequence, ensemble.load_scale), (state, sums, out.failures)
        begin = 0
        for kind in np.unique(own_kinds).tolist():
            end = begin + int((kinds == kind).sum())
            states = out.quaternion, out.velocity
            task = partial(kernel.march, members, bodies, carried, states, out.normal, grid, loads, kind)
            in_threads(task, (begin, end), size, threads, report)
            begin = end
        done = int(np.searchsorted(ensemble.stored, last, side="right")) - 1
    return out._replace(watched=_watched(sums))


def bodies_of(systems: SystemStack, load: Load) -> tuple[Array, NDArray[np.int64]]:
    """Return what the kernel needs of each body, (m or 1, BODY), and the form of its step."""
    from scipy.spatial.transform import Rotation

    from .lane_arrays import BODY, HEAVY, MOVED, PUSHED, STEADY

    basis, J = frames(systems)
    assert systems.dead_force is not None
    m, free, turned = len(systems), systems.axis is None, basis.swapaxes(1, 2)
    moments = J[:, range(3), range(3)]
    off = np.where(abs(J[:, 2, :2]) <= ROUND_OFF * moments.max(1)[:, None], 0.0, J[:, 2, :2]) * (not free)
    rows = np.zeros((m, BODY))
    if free:
        rows[:, 0:3] = (np.roll(moments, -1, 1) - np.roll(moments, -2, 1)) / moments
    rows[:, 3:5], rows[:, 5:8], rows[:, 8:11] = off, 1 / moments * [1, 1, free], moments
    rows[:, 11:20] = basis.reshape(m, 9)
    rows[:, 20:24] = np.roll(Rotation.from_matrix(basis).as_quat(), 1, axis=1)
    rows[:, 24:33] = (turned @ systems.dead_force).reshape(m, 9)
    rows[:, 33:42] = (turned @ load.damping @ basis).reshape(m, 9)
    rows[:, 42:45] = basis[:, 2] if free else (0, 0, 1)
    rows[:, 45:48] = systems.vertical
    more = load.damping.any() or any(term.kind == "space" for term in load.terms)
    kinds = np.where(off.any(1) | more, PUSHED, MOVED if free or load.terms else STEADY)
    return rows, np.where(rows[:, 24:33].any(1), HEAVY, kinds)


def frames(systems: SystemStack) -> tuple[Array, Array]:
    """Return the frames b, columns in body components, and the inertias in them, (m, 3, 3) each."""
    J = systems.convected_inertia
    if systems.axis is None:
        moments, basis = np.linalg.eigh(J)
        basis[:, :, 0] *= np.where(np.linalg.det(basis) < 0, -1.0, 1.0)[:, None]
        return basis, moments[:, :, None] * np.eye(3)
    basis = bases_of(systems.axis)
    plane = np.linalg.eigh((basis.swapaxes(1, 2) @ J @ basis)[:, :2, :2])[1]
    plane[:, :, 0] *= np.where(np.linalg.det(plane) < 0, -1.0, 1.0)[:, None]
    basis[:, :, :2] = basis[:, :, :2] @ plane
    return basis, basis.swapaxes(1, 2) @ J @ basis


def bases_of(axis: Array) -> Array:
    """Return the frames, as columns, that the smallest rotations of E3 to ±`axis` give, (m, 3, 3)."""
    sign = np.where(axis[:, 2] >= 0, 1.0, -1.0)
    x, y, z = (axis * sign[:, None]).T
    f = 1 / (1 + z)
    rows = (1 - x * x * f, -x * y * f, x, -x * y * f, 1 - y * y * f, y, -x, -y, z)
    basis: Array = np.stack(rows, axis=1).reshape(-1, 3, 3)
    basis[:, :, 1:] *= sign[:, None, None]
    return basis


def _at_nodes(load: Load, times: Array) -> tuple[Array, Array]:
    """Return the moments along the moving directors and in space at the nodes; no rows where there are none."""
    kinds = {term.kind for term in load.terms}
    moving, space = (load.sample(times, kind) if kind in kinds else np.zeros((0, 3)) for kind in ("body", "space"))
    return moving, space


def _watched(sums: Array) -> Array | None:
    return sums[:, :-1].reshape(-1, 4, COLUMNS) if len(sums) else None


def _broken_off(out: Outcome, sums: Array, step: int, stored: int, reason: str) -> Outcome:
    """Return what was good before the load failed at the beginning of a step; it has failed for all alike."""
    running = out.failures[:, 0] == Status.OK
    out.failures[running] = Status.LOAD, step, np.nan, np.nan
    out.quaternion[:, stored:], out.velocity[:, stored:], sums[...] = np.nan, np.nan, np.nan
    if out.normal is not None:
        out.normal[:, stored:] = np.nan
    return out._replace(watched=_watched(sums), reasons=dict.fromkeys(np.flatnonzero(running).tolist(), reason))
