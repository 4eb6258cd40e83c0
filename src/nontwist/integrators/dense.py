"""Outputs of a run between its nodes, where these lie on one trajectory (`expansion`): what is laid out, and found.

Loads that depend on time are polynomials in a step: those through their values at Chebyshev nodes inside of it.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.records import BODY, SUMS, Parts, pack, side_by_side, slab_layout, views
from ..geometry.arrays import Array, distinct
from ..geometry.attitudes import States
from ..kernels import machine_code
from ..loads import Load
from ..machine import cached_property
from .compiled import Compiled
from .expansion import LARGEST_MISMATCH, RUN, output_kernel
from .ivp import IVP, Outputs
from .marched_stacks import PreparedMarch, intervals_in, states_in
from .stack_march import StackMarch, march_of
from .stepping import PerThread

DEGREE = 9  # numbers of the polynomial of a load in a step; 2 where it is linear


class Dense:
    """A march whose outputs lie between nodes.

    Attributes
    ----------
    march : StackMarch
        From node to node.
    shapes : dict
        Of the arrays of outputs; those are named as those of the march.
    """

    def __init__(self, problem: IVP, scheme: Compiled) -> None:
        outputs, m = Outputs(problem), len(problem)
        node, since = np.append(0, outputs.node), np.append(0.0, outputs.since)
        is_inside, self._times = since > 0, np.append(problem.t_start, outputs.times)
        number, t = node[is_inside], since[is_inside]
        first = np.flatnonzero(np.diff(number, prepend=-1))
        step = number[first]
        march = problem.marched
        if march is None:
            nodes = distinct(np.concatenate([[0, problem.steps], step, step + 1, node]))
            march = march_of(replace(problem, output_times=None, stored=nodes), scheme)
        self.march, nodes = march, march.stored
        self.problem, self.skipped, unit = problem, int(not outputs.has_start), march.unit
        length = problem.step_at(step)
        shape = m, len(node)
        intervals = (m, len(node) - 1, SUMS.size) if problem.intervals else (0,)
        self.shapes: dict[str, tuple[int, ...]] = {"quaternions": (*shape, 4), "velocities": (*shape, 3)}
        self.shapes |= {"normals": (0,), "intervals": intervals}
        self._steps = problem.times(step), length
        self._arrays = {
            "bodies": march.bodies,
            "scales": march.scales,
            "rate": np.array([1.0 / unit]),
            "spans": march.lengths,
            "begin": np.searchsorted(nodes, step),
            "lengths": length / unit,
            "times": np.stack([self._steps[0], self._steps[0] + length], axis=1),
            "outputs": np.append(first, len(number)),
            "first_rows": np.flatnonzero(is_inside)[first],
            "parts": np.append(t / length[np.searchsorted(step, number)], np.ones(machine_code.lanes())),
            "rows": np.searchsorted(nodes, node),
            "inside": is_inside.astype(np.int64),
            "intervals": unit / np.append(1.0, outputs.length),
        }
        strides = {"body_stride": BODY.size * (len(march.bodies) > 1), "scale_stride": len(march.scales) > 1}
        self._counts = {"nodes": len(nodes), "output_count": len(node), "last": m, **strides}
        motion = march.parts.motion if len(march.groups) == 1 else "rows"  # the equations that members share
        motion, sums = "moved" if motion == "steady" else motion, problem.intervals
        summed = {"reports": sums, "integrates_velocity": sums and march.parts.integrates_velocity}
        self._kernel = output_kernel(march.parts._replace(motion=motion, lanes=1, **summed))

    def outputs(self, good: NDArray[np.int64], end: int | None) -> tuple[dict[str, Array], NDArray[np.int64]] | None:
        """Return the arrays of outputs and how many are good, given how many nodes are; None where these are apart.

        The last state of a march that was stopped counts as that of the next output.
        """
        march, rows, inside, changes = self.march, self._arrays["rows"], self._arrays["inside"], {}
        found = good - (end is not None)
        reached = np.searchsorted(rows + inside, found)
        if end is not None:
            last, n, since = int(found[0]), int(reached[0]), march.stack.times(end)
            names = "rows", "inside", "spans", "intervals"
            changes = {name: self._arrays[name].copy() for name in names}
            changes["rows"][n], changes["inside"][n], reached = last, 0, reached + 1
            changes["spans"][last - 1] = (since - march.stack.stored_times[last - 1]) / march.unit
            changes["intervals"][n] = march.unit / (since - self._times[n - 1])
        run = Between(self, march.arrays, found, reached, **changes)
        return (run.arrays, reached - self.skipped) if run.find() else None


class Between:
    """The outputs of a march between its nodes, in memory of their own."""

    def __init__(
        self, dense: Dense, nodes: dict[str, Array], found: NDArray[np.int64], good: NDArray[np.int64], **changes: Array
    ) -> None:
        self._kernel, self._mismatch, self._count = dense._kernel, np.zeros(len(good)), int(good.sum())
        self.arrays, array_addresses = side_by_side(**dense.shapes)
        known = dense._arrays | changes
        steps_taken = np.searchsorted(known["begin"] + 1, found)
        march, (begin, length), n = dense.march, dense._steps, int(steps_taken.max())
        loads, degree = polynomials(march.load, march.parts, begin[:n], length[:n], march.unit)
        row, self._keepalive = np.zeros(RUN.size, dtype=np.int64), (known, steps_taken, good, nodes, loads)
        pack(row, RUN, **dense._counts, **known, steps_taken=steps_taken, good=good, mismatch=self._mismatch)
        pack(row, RUN, polynomials=loads, degree=degree)
        pack(row, RUN, p=nodes["quaternions"], W=nodes["velocities"], means=nodes["intervals"])
        to = array_addresses
        pack(row, RUN, quaternions=to["quaternions"], velocities=to["velocities"], sums=to["intervals"])
        self._row, self._address = row, row.ctypes.data

    def find(self) -> bool:
        """Find them; return whether the nodes lie on one trajectory."""
        self._kernel.function_for(self._count)(self._address)
        return not (self._mismatch > LARGEST_MISMATCH).any()


def states_between(scheme: Compiled, problem: IVP, states: States) -> States | None:
    """Return the states of one body at the times asked for, given those at all nodes; None where these are apart."""
    plain = replace(problem, intervals=False, observed=False, progress=None)
    dense = Dense(plain, scheme)
    march = dense.march
    march.arrays["quaternions"][0] = states.quaternion[march.stack.stored]
    march.arrays["velocities"][0] = states.velocity[march.stack.stored]
    found = dense.outputs(np.array([len(march.stack.stored)]), None)
    return None if found is None else states_in(found[0], dense.skipped).part(0)


class PreparedDense:
    """A march of one body whose start is left open, with outputs between its nodes.

    A call finds the states alone. What is summed over intervals takes as long again: it comes from a second march from
    the same start, once it is asked for.
    """

    def __init__(self, problem: IVP, dense: Dense, march: PreparedMarch) -> None:
        self._problem, self._dense, self.skipped = problem, dense, dense.skipped
        self._march, self.expect = march, march.expect
        self._unit, self._slab = float(dense.march.bodies[0, BODY.unit]), slab_layout(dense.shapes)
        self._threads = PerThread(self._workspace)

    @cached_property
    def _substeps(self) -> PreparedMarch:
        return PreparedMarch(StackMarch(self._problem, self._dense.march.scheme))

    @cached_property
    def _summing(self) -> PreparedDense:
        """The same with what is summed."""
        dense = Dense(self._problem, self._dense.march.scheme)
        return PreparedDense(self._problem, dense, PreparedMarch(dense.march))

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Any, float, float]:
        """March from the quaternion `p`, scalar last, and W: as a prepared march, by substeps where nodes are apart."""
        found, squares, fastest = self._march(p, W, scale)
        if not squares < inf:
            return found, squares, fastest
        if (arrays := self.outputs(found, scale)) is None:
            found, squares, fastest = self._substeps(p, W, scale)
            return (found, None, ()), squares, fastest
        return (found, arrays, (tuple(p), tuple(W), scale)), squares, fastest

    def outputs(self, found: Array, scale: float) -> dict[str, Array] | None:
        """Return the arrays of outputs from the numbers that a prepared march has found; None where nodes are apart."""
        nodes, factor, memory, between = self._threads.own
        nodes[:], factor[0] = found, scale / self._unit
        return views(memory.copy(), self._slab) if between.find() else None

    def read(self, found: Any) -> dict[str, Any]:
        """Return the states of a run from what a call has found; its `_read` returns the rest."""
        nodes, arrays, start = found
        if arrays is None:
            return self._substeps.read(nodes)
        states = states_in(arrays, self.skipped).part(0)
        return {"states": states, "_read": lambda: self._summing.sums(self._summing(*start)[0])}

    def sums(self, found: Any) -> dict[str, Any]:
        """Return what a call has found beside the states."""
        nodes, arrays, _ = found
        march = self._dense.march
        means = intervals_in(march, arrays, self.skipped).of_one
        return means | {"memory": nodes[march.slab["states"][0]] * march.factors[0]}

    def _workspace(self) -> tuple[Array, Array, Array, Between]:
        """Return memory for one thread: states at nodes, the factor of the load, outputs, what finds them."""
        dense, march, factor = self._dense, self._dense.march, np.ones(1)
        nodes, _ = side_by_side(**march.shapes)
        every = np.array([len(march.stored)]), np.array([dense.shapes["quaternions"][1]])
        between = Between(dense, nodes, *every, scales=factor)
        return nodes["quaternions"].base, factor, between.arrays["quaternions"].base, between  # type: ignore[return-value]


def polynomials(load: Load, parts: Parts, begin: Array, length: Array, unit: float) -> tuple[Array, int]:
    """Return loads as polynomials in τ and in 1 - τ, (steps, 2, vectors, 3, degree), and how many numbers they have."""
    degree = 2 if load.is_linear else DEGREE
    x = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree) + 0.5) / degree)
    times = (begin[:, None] + length[:, None] * x).ravel()
    names, found = (parts.moving, "body"), (parts.space, "space")
    values = [load.sample(times, kind) for is_there, kind in (names, found) if is_there]  # type: ignore[arg-type]
    if parts.rotor:
        values.append(load.rotor_momentum(times) / unit)
    if not values:
        return np.zeros((0, degree)), degree
    y = np.stack(values, axis=1).reshape(len(begin), degree, len(values), 3)
    first = y[:, :1]  # a large number would be lost in the coefficients of its changes
    inverses = [np.linalg.inv(np.vander(z, increasing=True)) for z in (x, 1 - x)]
    both = np.stack([np.einsum("nj,sjvc->svcn", inverse, y - first) for inverse in inverses], 1)
    both[..., 0] += first
    if parts.rotor:
        slope = np.zeros_like(both[:, :, -1:])
        slope[..., :-1] = both[:, :, -1:, :, 1:] * np.arange(1, degree)
        slope *= unit / length[:, None, None, None, None] * np.array([1.0, -1.0])[:, None, None, None]
        both = np.concatenate([both, slope], axis=2)
    return np.ascontiguousarray(both), degree
