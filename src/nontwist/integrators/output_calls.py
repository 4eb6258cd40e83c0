"""The calls of a kernel in a march with outputs at any times (`engine.outputs`): which, in what order, with what loads.

A march pauses at the nodes at which there is output, and before and after each step with output inside. All outputs in
a stretch without moments are reached from where it begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.bodies import ANY, HEAVY
from ..engine.outputs import CALL, CALLS, COMPONENTS, EIGHT, GO, LEG, NODE, OUTPUT
from ..engine.records import BLOCK, SUMS
from ..geometry.arrays import Array
from .coasting import Coasting
from .load_samples import BYTES, COLUMNS, SAMPLES, WIDTHS, Samples, samples_of
from .rotors import at_nodes
from .spins import at_nodes as at_nodes_of_spin

if TYPE_CHECKING:
    from .problem import Problem
    from .stack_march import StackMarch

RESOLVED = 4  # units in the last place of a time within which an output is at a node


class Outputs:
    """Where the outputs of a problem lie on its grid.

    Attributes
    ----------
    node : (k,) int array, number of the last node that is not after the output
    since : (k,) array, s, time since that node; 0 where the output is the node
    length : (k,) array, s, time since the output before, of the first since the start
    times : (k,) array, s
    has_start : bool, whether there is output at the start, which is left out of these arrays
    """

    def __init__(self, problem: Problem) -> None:
        assert problem.asked is not None
        times, last = problem.asked, problem.steps
        borders, numbers, sizes = (np.array(part) for part in problem.grid)
        j = np.searchsorted(borders[1:-1], times, side="right")
        node = np.clip(np.floor(numbers[j] + (times - borders[j]) / sizes[j]).astype(np.int64), 0, last - 1)
        rounding = RESOLVED * np.spacing(max(abs(problem.t_start), abs(problem.t_end)))
        node -= problem.times(node) > times + rounding
        node += problem.times(np.minimum(node + 1, last)) <= times + rounding
        since = times - problem.times(node)
        since[since <= rounding] = 0.0
        self.has_start = bool(node[0] == 0 and since[0] == 0.0)
        self.length = np.diff(times, prepend=problem.t_start)[self.has_start :]
        self.times = times[self.has_start :]
        self.node, self.since = node[self.has_start :], since[self.has_start :]

    def __len__(self) -> int:
        return len(self.node)

    def before(self, step: int) -> int:
        """Return how many outputs lie before the end of a step, those at its beginning among them."""
        return int(np.searchsorted(self.node, step, side="right"))


class Calls(NamedTuple):
    """A list of calls, and all arrays that it points to."""

    head: NDArray[np.int64]
    arrays: tuple[Any, ...]


def calls(march: StackMarch, form: int, width: int, first: int, last: int) -> Calls:
    """Return the calls for steps from number `first` to `last`, whose loads have been sampled."""
    stack, outputs = march.stack, march.outputs
    assert outputs is not None
    coasting = march.coasting if form not in (HEAVY, ANY) else Coasting(stack, None)
    here = np.flatnonzero((outputs.node >= first) & ((outputs.node < last) | (last == stack.steps)))
    node, inside, n = outputs.node[here], outputs.since[here] > 0, len(here)
    stretch = coasting.stretch_of(node)
    stretch[(stretch >= 0) & ~inside & np.isin(node, coasting.begin)] = -1  # there nothing has moved yet
    free = stretch >= 0
    origin = coasting.begin[stretch[free]]
    # Steps from stop to stop.
    numbers = np.array(stack.grid.numbers)
    stepped = node[inside & ~free]
    stop = np.unique(np.concatenate([[first, last], node[~free], stepped + 1, numbers, coasting.begin, coasting.end]))
    stop = stop[(stop >= first) & (stop <= last)]
    begin, end, a = stop[:-1], stop[1:], len(stop) - 1
    rows, reals = np.zeros((a + n, CALL.size), dtype=np.int64), np.ones((a + n, 2))
    on_grid = np.searchsorted(numbers[1:-1], begin, side="right")
    steps, own = rows[:a], rows[a:]
    steps[:, CALL.coasts] = np.isin(begin, coasting.begin)
    steps[:, CALL.op] = np.where(np.isin(begin, stepped) | (steps[:, CALL.coasts] > 0), LEG, GO)
    steps[:, CALL.first], steps[:, CALL.steps] = begin, end - begin
    steps[:, CALL.step] = march.block[BLOCK.step] + 16 * on_grid
    steps[:, CALL.begins] = (begin == numbers[on_grid]) & (on_grid > 0)
    per_step, sampled = march.count, march.sampled_before(begin, first)
    for column, place, each in zip(COLUMNS, SAMPLES, BYTES, strict=True):
        if march.block[place]:
            steps[:, column] = march.block[place] + each * per_step * sampled
    # Outputs.
    sizes = march.sizes[np.searchsorted(numbers[1:-1], node, side="right"), 0]
    since = outputs.since[here] / march.unit
    since[free] = (stack.times(node[free]) - stack.times(origin) + outputs.since[here][free]) / march.unit
    nodes = free & ~inside
    since[nodes] = sizes[nodes] * (node - coasting.begin[stretch])[nodes] if nodes.any() else 0.0
    lengths = np.stack([since, np.full(n, 1.0 / march.unit)], axis=1)
    own[:, CALL.op] = np.where(inside | free, OUTPUT, NODE)
    own[:, CALL.first], own[free, CALL.first] = node, origin
    own[:, CALL.steps] = inside | free
    own[:, CALL.step] = lengths.ctypes.data + 16 * np.arange(n)
    own[:, CALL.place], own[:, CALL.coasts] = here + 1, free
    reals[a:, 0], reals[a:, 1] = march.unit / outputs.length[here], since / sizes
    middles = march.stages[form][1]
    loads = _sampled(march, np.where(inside & ~free, stack.times(node), np.nan), outputs.since[here], middles)
    for column, array in zip(COLUMNS, loads, strict=True):
        if array is not None:
            own[:, column] = array.ctypes.data + array.strides[0] * per_step * np.arange(n)
    kind = np.concatenate([np.full(a, 1), np.where(own[:, CALL.op] == NODE, 0, 2)])
    order = np.lexsort((kind, rows[:, CALL.first]))
    rows, reals = rows[order], reals[order]
    within = march.scheme.within(march.order)
    head = np.zeros(CALLS.size, dtype=np.int64)
    named = {
        "kernel": march.kernel(form, width).address,
        "side": march.kernel(form, width, observes=False).address,
        "width": width,
        "calls": a + n,
        "rows": rows.ctypes.data,
        "reals": reals.ctypes.data,
        "totals": march.arrays["totals"].ctypes.data,
        "stages": march.stages_of_guess,
        "within": 0 if within is None else within.ctypes.data,
        "guesses": march.guesses.start,
    }
    for name, number in named.items():
        head[getattr(CALLS, name)] = number
    return Calls(head, (rows, reals, lengths, loads, within))


def _sampled(march: StackMarch, begin: Array, length: Array, middles: Array) -> Samples:
    """Return times, moments, forces, rotors and spin at the nodes of steps from `begin` on; NaN: no step."""
    if not len(begin):
        return (None,) * len(WIDTHS)
    systems, load = march.stack.systems, march.load
    spin = at_nodes_of_spin(systems, np.nan_to_num(begin), np.nan_to_num(begin + length), middles, march.unit)
    if not load.terms:
        return *((None,) * (len(WIDTHS) - 1)), spin
    at = (begin[:, None] + length[:, None] * middles).reshape(-1)
    is_known = ~np.isnan(at)
    found: list[Array | None] = [at]
    for array in samples_of(load, at[is_known])[1:]:
        whole = None if array is None else np.zeros((at.size, array.shape[1]))
        if whole is not None:
            whole[is_known] = array
        found.append(whole)
    rotors = np.zeros((at.size, 6)) if load.rotors else None
    if rotors is not None:
        steps = ~np.isnan(begin)
        first, last = begin[steps], begin[steps] + length[steps]
        rotors[is_known] = at_nodes(load, first, last, length[steps], middles, march.unit)
    return *found, rotors, spin


def workspace(width: int, march: StackMarch) -> Array:
    """Return room for a list of calls, for so many members at a time."""
    size, stages = march.arrays["states"].shape[1], march.stages_of_guess
    return np.zeros(width * (2 * size + 2 * SUMS.size + 2 * COMPONENTS * stages + EIGHT))
