"""The list of calls of a kernel that a march is (`engine.outputs`): which, in what order, with what loads.

A march pauses where the length of steps changes. With outputs at any times it pauses also at the nodes at which there
is output, and before each step with output inside. All outputs in a stretch without moments are reached from
where it begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.layout import put
from ..engine.outputs import CALL, CALLS, NODE, OUTPUT
from ..engine.records import Parts
from ..geometry.arrays import Array, distinct
from .coasting import Coasting
from .load_samples import NOTHING, addresses

if TYPE_CHECKING:
    from .problem import IVP
    from .stack_march import StackMarch

RESOLVED = 4  # units in the last place of a time within which an output is at a node
Rows = NDArray[np.int64]


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

    def __init__(self, problem: IVP) -> None:
        times, last = np.asarray(problem.asked), problem.steps
        node = np.clip(problem.steps_ended(times), 0, last - 1)
        j, ends = problem.stretch_of(node), abs(np.array(problem.grid.borders))
        rounding = RESOLVED * np.spacing(np.maximum(ends[j], ends[j + 1]))
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

    def is_at(self, step: int) -> bool:
        """Return whether an output is the beginning of a step."""
        return bool(np.any((self.node == step) & (self.since == 0.0)))


class Listed(NamedTuple):
    """A list of calls, and all arrays that it points to."""

    head: Rows
    arrays: tuple[Any, ...]
    has_outputs: bool


def listed(march: StackMarch, parts: Parts, width: int, first: int, last: int, rows: Rows | None = None) -> Listed:
    """Return the calls for steps from number `first` to `last`, whose loads have been sampled, or those of `rows`.

    `width` members of a group are marched at a time.
    """
    coasting = Coasting(march.stack, None) if parts.dead and len(march.coasting) else march.coasting
    head, has_outputs = np.zeros(CALLS.size, dtype=np.int64), march.outputs is not None and rows is None
    alive: tuple[Any, ...] = ()
    if has_outputs:
        rows, rates, alive = _with_outputs(march, parts, first, last, coasting)
        put(head, CALLS, side=march.kernel(parts, width, observes=False).address, rates=rates)
        alive = rates, alive
    elif rows is None:
        rows = legs(march, first, last, coasting)
    kernel = march.kernel(parts, width).address
    put(head, CALLS, kernel=kernel, calls=len(rows), rows=rows, guesses=march.guesses.start)
    return Listed(head, (rows, alive), has_outputs)


def legs(march: StackMarch, first: int, last: int, coasting: Coasting, *stops: Any) -> Rows:
    """Return the calls for steps of the grid, one for each stretch and from stop to stop."""
    numbers = np.array(march.stack.grid.numbers)
    stop = distinct(np.concatenate([[first, last], numbers, coasting.begin, coasting.end, *stops]))
    stop = stop[(stop >= first) & (stop <= last)]
    begin, end = stop[:-1], stop[1:]
    stretch, within = np.searchsorted(numbers[1:-1], begin, side="right"), coasting.stretch_of(begin)
    free = np.flatnonzero(within >= 0)
    done = np.searchsorted(march.stored, begin, side="right") - 1
    rows = _rows(march, begin, end - begin, done, march.sizes, stretch)
    rows[:, CALL.begins] = (begin == numbers[stretch]) & (stretch > 0)
    rows[free, CALL.unloaded_from] = coasting.begin[within[free]]
    rows[free, CALL.loaded_from] = coasting.end[within[free]]
    if march.loads is not NOTHING:
        rows[:, CALL.times : CALL.op] = addresses(march.loads, march.count * march.sampled_before(begin, first))
    return rows


def _rows(march: StackMarch, first: Rows, steps: Any, done: Any, sizes: Array, which: Rows) -> Rows:
    """Return calls that take so many steps from `first` on, each of one of the `sizes`."""
    rows = np.zeros((len(first), CALL.size), dtype=np.int64)
    rows[:, CALL.first], rows[:, CALL.steps], rows[:, CALL.done] = first, steps, done
    rows[:, CALL.unloaded_from] = rows[:, CALL.loaded_from] = first + steps
    rows[:, CALL.step] = sizes.ctypes.data + sizes.strides[0] * which
    return rows


def _with_outputs(
    march: StackMarch, parts: Parts, first: int, last: int, coasting: Coasting
) -> tuple[Rows, Array, Any]:
    """Return the calls of steps and outputs in order, and the arrays that belong to them."""
    stack, outputs, middles = march.stack, march.outputs, march.stages[parts][1]
    assert outputs is not None
    here = np.flatnonzero((outputs.node >= first) & ((outputs.node < last) | (last == stack.steps)))
    node, since, inside, n = outputs.node[here], outputs.since[here], outputs.since[here] > 0, len(here)
    stretch = coasting.stretch_of(node)
    stretch[(stretch >= 0) & ~inside & np.isin(node, coasting.begin)] = -1  # there nothing has moved yet
    free = stretch >= 0
    origin, is_step = coasting.begin[stretch[free]], inside & ~free
    steps = legs(march, first, last, coasting, node[~free])
    sizes = march.sizes[np.searchsorted(stack.grid.numbers[1:-1], node, side="right"), 0]
    length = since / march.unit
    length[free] = (stack.times(node[free]) - stack.times(origin) + since[free]) / march.unit
    nodes = free & ~inside
    length[nodes] = sizes[nodes] * (node - coasting.begin[stretch])[nodes] if nodes.any() else 0.0
    lengths, begin = np.stack([length, np.full(n, 1.0 / march.unit)], axis=1), node.copy()
    begin[free] = origin
    own = _rows(march, begin, (inside | free).astype(np.int64), 0, lengths, np.arange(n))
    own[free, CALL.unloaded_from] = origin
    own[:, CALL.op], own[:, CALL.place] = np.where(inside | free, OUTPUT, NODE), here + 1
    t, h = stack.times(node[is_step]), since[is_step]
    loads = march.sampled_at(lambda: (t[:, None] + h[:, None] * middles).ravel(), lambda: (t, t + h, h), middles)
    own[is_step, CALL.times : CALL.op] = addresses(loads, march.count * np.arange(len(t)))
    own[:, CALL.begins] = np.isin(begin, stack.grid.numbers[1:-1])
    rates = np.append(march.unit / outputs.length[here], np.ones(len(steps)))
    rows = np.concatenate([own, steps])
    order = np.argsort(rows[:, CALL.first], kind="stable")
    return rows[order], rates[order], (lengths, loads)
