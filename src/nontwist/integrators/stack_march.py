"""A stack of problems laid out for the compiled march, and marched; one run is a stack of one.

A march is a list of calls of its kernel (`engine.workspace`), some steps at a time, for whose nodes loads that depend
on time alone are sampled beforehand. Members with the same kind of motion are marched together, in threads. What a
member becomes depends on that member alone.

A march pauses where the length of steps changes. With outputs at any times it pauses also at the nodes at which there
is output, and before each step with output inside. All outputs in a segment without moments are reached from
where it begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.body_frames import power_of_two
from ..engine.called_functions import StateFunctions
from ..engine.marching import Text, march_kernel
from ..engine.records import (
    BLOCK,
    BODY,
    FAILURE,
    OBSERVED,
    STATE,
    SUMS,
    WORK,
    Parts,
    pack,
    separate_arrays,
    side_by_side,
    slab_layout,
)
from ..engine.workspace import CALL, carry_out, carry_out_outputs, enter
from ..geometry.arrays import Array, aligned, distinct
from ..kernels import machine_code
from ..kernels.kernel import Kernel
from .compiled import Compiled
from .ivp import IVP, Failure, Outputs, Status
from .load_samples import NOTHING, Samples, Unloaded, addresses, as_marched, march_parts, orbit_of, sampled
from .stepping import in_threads, progress

NODES, CALLED_NODES = 2**17, 2**8  # that are sampled and marched at a time; where functions in Python are called
SMALLEST, LARGEST, FEW = 16, 1024, 2  # members of a block; that are marched one by one
SHORTEST, FIRST = 1e-140, np.zeros(1, dtype=np.int64)
NEVER = np.array([0, 2**62])  # steps at which a march stores a state by itself
EPS, SAME = 2.0**-52, 1e-12


def unit_of_time(sizes: Sequence[float]) -> float:
    """Return the power of two near the longest step, s, in which a march measures time; a ValueError out of range."""
    for h in (min(sizes), max(sizes)):
        if not SHORTEST <= h <= 1 / SHORTEST:
            bounds = f"{SHORTEST:g} and {1 / SHORTEST:g} s"
            raise ValueError(f"step = {h:.3g} s is not between {bounds}; choose another unit of time")
    return float(power_of_two(np.max(sizes)))


class StackMarch:
    """A march of a stack: its arrays, laid out for the kernels.

    Attributes
    ----------
    groups : list of Parts
        What kernels are made for.
    group : (m,) array
        Which of them marches each member.
    """

    def __init__(self, stack: IVP, scheme: Compiled, **known: Any) -> None:
        """Lay out a stack; `known` are parts that there are in any case."""
        self.stack, self.scheme, self.needs = stack, scheme, scheme.needs
        self.outputs = None if stack.output_times is None else Outputs(stack)
        self.unit = unit_of_time(stack.grid.sizes)
        self._group_members(known)
        sizes = np.array(stack.grid.sizes)
        self.sizes = np.stack([sizes / self.unit, np.full(len(sizes), 1.0 / self.unit)], axis=1)
        self.stored = stack.stored
        self.lengths = self._lengths(stack.stored) if self.groups[0].needs_means else np.ones(len(stack.stored))
        if self.outputs is not None:  # the march writes nothing by itself, and sums over time
            self.stored, self.lengths = NEVER, np.ones(1)
        self._lay_out()
        skips_unloaded = scheme.is_exact_without_load and not self.parts.dead
        self.sampled_steps = int(stack.steps_until(self.load.end)) if skips_unloaded else stack.steps
        self.part: tuple[int, int, Array] | None = None  # that is marched, the load at its nodes, nodes of a step
        self.loads, self.count = NOTHING, 1
        self.begin(stack)

    def _group_members(self, known: dict[str, Any]) -> None:
        """Find the load, the functions and the bodies as they are marched, and the kinds of motion of the members."""
        stack, scheme = self.stack, self.scheme
        systems, self.load = as_marched(stack, scheme.is_director_scheme)
        has_more = known.get("space", False)  # a moment that is added to the load
        self.about = None if has_more else orbit_of(systems, self.load, self.unit, scheme)
        self.functions = StateFunctions(self.load, self.needs.action)
        known |= {"function": self.functions.moments is not None, "generalised": bool(self.functions.generalised)}
        known["memory"] = self.load.internal_state.size
        known.setdefault("integrates_velocity", stack.intervals and self.load.drives)
        known |= {"orbit": self.about is not None, "reports": stack.intervals, "observes": stack.observed}
        how = systems, self.load, self.unit, stack.load_scale, scheme
        self.bodies, self.groups, group = march_parts(*how, **known)
        self.group = np.broadcast_to(group, len(stack))
        self.parts = self.groups[0]._replace(dead=any(parts.dead for parts in self.groups))
        self.sequence = FIRST if len(stack) == 1 else np.argsort(self.group, kind="stable")
        self.scales, self.table = stack.load_scale / self.bodies[:, BODY.unit], self.needs.table
        self.stages = {parts: scheme.stages(parts) for parts in self.groups}
        self.unloaded = Unloaded(stack, self.load if scheme.is_exact_without_load else None)

    def _lay_out(self) -> None:
        """Make the arrays of results and of what is carried, and the block that tells a kernel where all is."""
        stack, m, none = self.stack, len(self.stack), (0,)
        director, z = self.scheme.is_director_scheme, self.load.internal_state.size
        count = len(stack.stored) if self.outputs is None else 1 + len(self.outputs)
        size = STATE.size + self.needs.beside + 2 * z
        self.shapes: dict[str, tuple[int, ...]] = {
            "quaternions": (m, count, 4),
            "velocities": (m, count, 3),
            "internals": (m, count, z) if z else none,
            "normals": (m, count, 6) if director else none,
            "intervals": (m, count - 1, SUMS.size) if stack.intervals else none,
            "states": (m, size),
            "failures": (m, FAILURE.size),
            "sums": (m, SUMS.size) if stack.intervals else none,
            "totals": (m, SUMS.size) if self.outputs is not None else none,
            "observed": (m, OBSERVED.size) if stack.observed else none,
        }
        self.slab = slab_layout(self.shapes)
        self.arrays, array_addresses = (side_by_side if m == 1 or stack.on_gpu else separate_arrays)(**self.shapes)
        self.guesses = slice(STATE.auxiliary + 6 * director, size)
        self.block = np.zeros(BLOCK.size, dtype=np.int64)
        pack(self.block, BLOCK, **array_addresses, members=m, state_size=size, output_count=count, director=director)
        pack(self.block, BLOCK, is_constrained=self.parts.is_constrained, action=self.needs.action, orbit=self.about)
        self.internal_scales, own = self.load.internal_scale, self.functions
        pack(self.block, BLOCK, functions=own.moments, generalised=own.generalised, terms=own.terms)
        pack(self.block, BLOCK, responses=own.responses, internal=z, internal_scales=self.internal_scales)
        pack(self.block, BLOCK, body_stride=BODY.size * (len(self.bodies) > 1), scale_stride=len(self.scales) > 1)
        pack(self.block, BLOCK, order=self.sequence, bodies=self.bodies, scales=self.scales, table=self.table)
        pack(self.block, BLOCK, stored=self.stored, lengths=self.lengths, step=self.sizes)

    def kernel(self, parts: Parts, width: int = 1, **changes: Any) -> Any:
        """Return what marches a group, so many at a time; `changes` of the parts."""
        return march_kernel(*self.made_for(parts, width, **changes))

    def made_for(self, parts: Parts, width: int, **changes: Any) -> tuple[Text, Parts]:
        """Return the text that marches a group, so many at a time, and the parts that it is for."""
        changes |= {"nodes": len(self.stages[parts][1]), "lanes": width}
        changes["skips_unloaded"] = len(self.unloaded) > 0 and not parts.dead
        return self.scheme.text(parts.motion), parts._replace(**changes)

    def begin(self, stack: IVP) -> None:
        """Enter the start of `stack`, a stack of the same bodies as that of this march."""
        arrays, director = self.arrays, self.scheme.is_director_scheme
        arrays["quaternions"][:, 0], arrays["velocities"][:, 0] = stack.quaternion, stack.velocity
        if arrays["internals"].size:
            arrays["internals"][:, 0] = self.load.internal_state if stack.internal is None else stack.internal
        if director and stack.normal is not None:
            arrays["normals"][:, 0] = stack.normal
        enter.function_for(1)(self.block.ctypes.data)

    def _lengths(self, stored: NDArray[np.int64]) -> Array:
        """Return the lengths of the intervals between nodes of these numbers, in units of time of the march."""
        numbers = np.array(self.stack.grid.numbers)
        inner = numbers[(numbers > stored[0]) & (numbers < stored[-1])]
        indices = np.searchsorted(stored, inner)
        more = stored[indices] != inner
        ends = np.insert(stored, indices[more], inner[more])
        size = self.sizes[np.searchsorted(numbers[1:-1], ends[:-1], side="right"), 0]
        return np.add.reduceat(np.diff(ends) * size, np.searchsorted(ends, stored[:-1]))

    def sampled_before(self, steps: NDArray[np.int64], first: int) -> NDArray[np.int64]:
        """Return of how many steps from `first` on, before each of `steps`, the load is sampled."""
        skipped = 0 if self.parts.dead else self.unloaded.before(steps) - self.unloaded.before(np.array([first]))
        return steps - first - skipped

    def by_section(self, *values: Any) -> Array:
        """Return a number for each of those that a member carries, (m or 1, numbers), from one for each section.

        These are p; s and what it was rounded by; c; the auxiliary ones; increments of the momentum, and of directions;
        z, and what it was rounded by.
        """
        more, z = self.needs.beside // 2, self.parts.memory
        of_state = np.diff([0, STATE.s, STATE.compensation, STATE.c, STATE.auxiliary, STATE.size])
        each = np.stack(np.broadcast_arrays(*np.atleast_1d(*values)), axis=1)
        return np.repeat(each, [*of_state, more, more, z, z], axis=1)

    @property
    def factors(self) -> Array:
        """What the carried states are multiplied by to have the units of the caller, (m or 1, numbers of a member)."""
        moment = self.bodies[:, BODY.unit]
        s, rest = (1 / self.unit,) * 2 if self.scheme.is_director_scheme else (moment * self.unit, moment)
        return self.by_section(1.0, s, s, 1.0, rest, moment * self.unit, 1.0, 1.0, 1.0)

    def is_start(self, carried: Array) -> bool:
        """Whether carried numbers, in units of the march, belong to the states that it starts from."""
        states, any_number = self.arrays["states"], np.inf
        size = abs(states[:, STATE.s : STATE.compensation]).max() or 1.0
        sign = np.where((carried[:, :4] * states[:, :4]).sum(1) < 0, -1.0, 1.0)
        N = SAME * size if self.parts.is_director_scheme else any_number
        others = any_number, any_number, 0.0, any_number
        most = self.by_section(SAME, SAME * size, any_number, 4 * EPS, N, *others)
        return not (abs(self.by_section(sign, *(1.0,) * 8) * carried - states) > most).any()

    def resume(self, memory: Array) -> None:
        """Continue from what the run before carried, where it is the state that this march starts from."""
        states = self.arrays["states"]
        if memory.shape != states.shape or not self.is_start(known := memory / self.factors):
            return
        states[:] = known
        if self.scheme.is_exact_without_load:
            return
        for parts, _, span, _ in self._tasks(1):  # the first node has the bits of the last before
            self._leave(parts, span, 0, 0)
        for name in ("quaternions", "velocities", "normals", "internals"):
            if self.arrays[name].size:
                self.arrays[name][:, 0] = self.arrays[name][:, 1]

    def run(self, threads: int = 1) -> tuple[Failure | None, int | None]:
        """March all members over all steps.

        Returns
        -------
        failure : the load, which all members have in common, or an interruption
        end : steps done before an interruption

        Raises
        ------
        ValueError
            The load is wrong from the start.
        KeyboardInterrupt
            In a stack of more than one.
        """
        stack, first, done, counted = self.stack, 0, 0, None
        tasks, (ends, count) = self._tasks(threads), self._pauses()
        report = progress(stack, count)
        try:
            for last in ends:
                for parts, width, span, size in tasks:
                    try:
                        self.sample(parts, first, last)
                    except ValueError as error:
                        if first == 0:
                            raise
                        return Failure(Status.LOAD, first, np.nan, np.nan, error), None
                    run = partial(self._run, listed(self, parts, width, first, last), width)
                    in_threads(run, span, size, threads, report if len(stack) > 1 else lambda members: None)
                self.functions.require_no_interrupt()
                if self.arrays["failures"][:, 0].all():
                    break
                done = self.good(last) - 1 if self.outputs is None else self.outputs.before(last - 1)
                if len(stack) == 1 and last < stack.steps:
                    counted = done, last, self.arrays["states"].copy(), self._running_sums().copy()
                if len(stack) == 1:  # what is reported counts
                    report(1)
                first = last
        except KeyboardInterrupt as stop:
            if len(stack) > 1:
                raise
            return self._stopped(counted, str(stop))
        return None, None

    def _pauses(self) -> tuple[Iterable[int], int]:
        """Return the steps at which the march pauses, the last one among them, and how many they are.

        Where nothing but the states that are stored is left to do, it pauses after so many of those.
        """
        steps, stored = self.stack.steps, self.stack.stored
        length = NODES if self.functions.load.is_compiled else CALLED_NODES
        by_steps = steps if self.stack.observed else self.sampled_steps
        marched = range(0, by_steps, max(1, length // max(len(middles) for _, middles in self.stages.values())))[1:]
        rest = [by_steps] if 0 < by_steps < steps else []
        if self.outputs is not None:  # a segment without moments is one call
            ends = np.array([*marched, *rest])
            within = self.unloaded.segment_of(ends)
            ends = np.unique(np.where(within >= 0, self.unloaded.end[within], ends)) if len(self.unloaded) else ends
            return chain(ends[ends < steps].tolist(), [steps]), int(np.sum(ends < steps)) + 1
        rest += stored[int(np.searchsorted(stored, by_steps, side="right")) + NODES - 1 : -1 : NODES].tolist()
        return chain(marched, rest, [steps]), len(marched) + len(rest) + 1

    def sample(self, parts: Parts, first: int, last: int) -> None:
        """Sample the load at the nodes of some steps of a group, of those on which moments may act."""
        gamma, middles = self.stages[parts]
        part = first, min(last, self.sampled_steps), middles
        if self.part is not None and part[:2] == self.part[:2] and middles is self.part[2]:
            return
        self.part, steps = part, np.arange(*part[:2])
        if len(self.unloaded) and not self.parts.dead:
            steps = steps[self.unloaded.segment_of(steps) < 0]
        stack, self.count = self.stack, len(middles)

        def ends() -> tuple[Array, Array, Array]:
            return stack.times(steps), stack.times(steps + 1), stack.step_at(steps)

        self.loads = self.samples_at(lambda: stack.nodes(steps, middles), ends, middles) if len(steps) else NOTHING
        pack(self.block, BLOCK, fractions=gamma)

    def samples_at(self, times: Any, steps: Any, middles: Array) -> Samples:
        """Return what acts at nodes (`load_samples.sampled`)."""
        return sampled(self.stack.systems, self.load, self.unit, times, steps, middles)

    def _stopped(self, counted: Any, reason: str) -> tuple[Failure, int | None]:
        """Go back to the end of the last part that counts, and write the state there."""
        done, last, states, sums = counted or (0, 0, None, None)
        if counted:
            self.arrays["states"][:], self._running_sums()[:] = states, sums
        stack, end = self.stack, None
        self.arrays["failures"][:] = 0.0
        if self.outputs is None:
            since, length = float(stack.times(stack.stored[done])), float(self.lengths[done] * self.unit)
        else:
            since, length = float(self.outputs.times[done - 1]) if done else stack.t_start, self.unit
            self.arrays["sums"][:] = self.arrays["totals"]
        if (passed := float(stack.times(last) - since)) > 0:
            end = last
            self._leave(self.groups[0], (0, 1), last, done)
            if stack.intervals:
                self.arrays["intervals"][0, done, : SUMS.work] *= length / passed
            outputs = self.outputs
            if outputs is not None and np.any((outputs.node == last) & (outputs.since == 0.0)):  # one is there
                end = None
        return Failure(Status.INTERRUPTED, last, np.nan, np.nan, reason), end

    def _running_sums(self) -> Array:
        """Return the running sums over the present interval."""
        return self.arrays["sums" if self.outputs is None else "totals"]

    def _leave(self, parts: Parts, span: tuple[int, int], step: int, done: int) -> None:
        """Write the states of members of a group as if they were those of the node after `done`."""
        part = max(step - 1, 0), max(step, 1)
        row, self.block[BLOCK.writes_end] = grid_calls(self, *part, self.unloaded)[-1:], 1
        pack(row[0], CALL, first=step, steps=0, done=done, begins=0)
        self._run(listed(self, parts, 1, *part, row), 1, *span)
        self.block[BLOCK.writes_end] = 0

    def _tasks(self, threads: int) -> list[tuple[Parts, int, tuple[int, int], int]]:
        """Return groups, how many bodies are marched at a time, which members, and in what blocks."""
        m, found, begin = len(self.stack), [], 0
        if m == 1:
            return [(self.groups[0], 1, (0, 1), 1)]
        scheme, lanes = self.scheme, machine_code.lanes()
        size = int(np.clip(-(-m // (4 * threads)), SMALLEST, LARGEST))
        for parts, number in zip(self.groups, np.bincount(self.group).tolist(), strict=True):
            is_single = number <= FEW or not scheme.in_lanes or self.parts.memory > 0  # whose workspace is that of one
            found.append((parts, 1 if is_single else lanes, (begin, begin + number), size))
            begin += number
        return found

    def good(self, step: int) -> int:
        """Return how many stored states there are before the end of a step that has failed."""
        return int(np.searchsorted(self.stack.stored_times, self.stack.times(step), side="right"))

    @property
    def skipped(self) -> int:
        """1 where the start is no output, else 0."""
        return int(self.outputs is not None and not self.outputs.has_start)

    def _run(self, todo: Listed, width: int, first: int, last: int) -> None:
        """Carry out a list of calls for some members."""
        block, workspace, _ = self.laid(todo, width, first, last)
        todo.driver.function_for(1)(block.ctypes.data)
        self.last_call = workspace[width * WORK.state_call :]  # what the load was called with last

    def workspace_size(self, width: int) -> int:
        """Return the numbers of the workspace of so many members."""
        each, shared = self.needs.scratch(self.parts.memory)
        return int(width * (WORK.size + self.parts.memory_size + each) + shared)

    def laid(
        self, todo: Listed, width: int = 1, first: int = 0, last: int = 1
    ) -> tuple[NDArray[np.int64], Array, tuple[Any, ...]]:
        """Return a block with which some members are marched, its workspace, and what else it points to."""
        block, scratch = self.block.copy(), np.zeros(width * self.shapes["states"][1])
        workspace = aligned(self.workspace_size(width))
        pack(block, BLOCK, **todo.values, workspace=workspace, scratch=scratch, begin=first, end=last)
        return block, workspace, (scratch, todo)


def march_of(stack: IVP, scheme: Compiled) -> StackMarch:
    """Return the march of a stack, on a GPU where that is asked for."""
    if not stack.on_gpu:
        return StackMarch(stack, scheme)
    from .gpu_stack import GpuMarch

    return GpuMarch(stack, scheme)


Rows = NDArray[np.int64]


class Listed(NamedTuple):
    """A list of calls: what the block has of it, and what its rows point to."""

    values: dict[str, Any]
    keepalive: Any
    driver: Kernel  # carries it out
    parts: Parts


def listed(
    march: StackMarch,
    parts: Parts,
    width: int,
    first: int,
    last: int,
    rows: Rows | None = None,
    work: float | None = None,
) -> Listed:
    """Return the calls for steps from number `first` to `last`, whose loads have been sampled, or those of `rows`.

    `width` members of a group are marched at a time. `work`: how many steps will be taken, where calls are made again.
    """
    unloaded = Unloaded(march.stack, None) if parts.dead and len(march.unloaded) else march.unloaded
    rates, keepalive, driver = None, None, carry_out
    if march.outputs is not None and rows is None:
        rows, rates, keepalive = _calls_with_outputs(march, parts, first, last, unloaded)
        driver = carry_out_outputs(march.parts._replace(lanes=width))
    elif rows is None:
        rows = grid_calls(march, first, last, unloaded)
    values = {"calls": len(rows), "rows": rows, "rates": rates, "guesses": march.guesses.start}
    if not march.stack.on_gpu:
        work = (last - first) * len(march.stack) / width if work is None else work
        kernels = march.kernel(parts, width), None if rates is None else march.kernel(parts, width, observes=False)
        found = (0 if one is None else machine_code.pointer_address(one.function_for(work)) for one in kernels)
        values |= zip(("kernel", "side"), found, strict=True)
    return Listed(values, keepalive, driver, parts)


def grid_calls(march: StackMarch, first: int, last: int, unloaded: Unloaded, *stops: Any) -> Rows:
    """Return the calls for steps of the grid, one for each segment and from stop to stop."""
    numbers = np.array(march.stack.grid.numbers)
    stop = distinct(np.concatenate([[first, last], numbers, unloaded.begin, unloaded.end, *stops]))
    stop = stop[(stop >= first) & (stop <= last)]
    begin, end = stop[:-1], stop[1:]
    segment, within = np.searchsorted(numbers[1:-1], begin, side="right"), unloaded.segment_of(begin)
    free = np.flatnonzero(within >= 0)
    done = np.searchsorted(march.stored, begin, side="right") - 1
    rows = _rows(march, begin, end - begin, done, march.sizes, segment)
    rows[:, CALL.begins] = (begin == numbers[segment]) & (segment > 0)
    rows[free, CALL.unloaded_from] = unloaded.begin[within[free]]
    rows[free, CALL.loaded_from] = unloaded.end[within[free]]
    if march.loads is not NOTHING:
        rows[:, CALL.times : CALL.output_row] = addresses(march.loads, march.count * march.sampled_before(begin, first))
    return rows


def _rows(march: StackMarch, first: Rows, steps: Any, done: Any, sizes: Array, which: Rows) -> Rows:
    """Return calls that take so many steps from `first` on, each of one of the `sizes`."""
    rows = np.zeros((len(first), CALL.size), dtype=np.int64)
    rows[:, CALL.first], rows[:, CALL.steps], rows[:, CALL.done] = first, steps, done
    rows[:, CALL.unloaded_from] = rows[:, CALL.loaded_from] = first + steps
    rows[:, CALL.step] = sizes.ctypes.data + sizes.strides[0] * which
    return rows


def _calls_with_outputs(
    march: StackMarch, parts: Parts, first: int, last: int, unloaded: Unloaded
) -> tuple[Rows, Array, Any]:
    """Return the calls of steps and outputs in order, and the arrays that belong to them."""
    stack, outputs, middles = march.stack, march.outputs, march.stages[parts][1]
    assert outputs is not None
    here = np.flatnonzero((outputs.node >= first) & ((outputs.node < last) | (last == stack.steps)))
    node, since, inside, n = outputs.node[here], outputs.since[here], outputs.since[here] > 0, len(here)
    segment = unloaded.segment_of(node)
    segment[(segment >= 0) & ~inside & np.isin(node, unloaded.begin)] = -1  # there nothing has moved yet
    free = segment >= 0
    origin, is_step = unloaded.begin[segment[free]], inside & ~free
    steps = grid_calls(march, first, last, unloaded, node[~free])
    sizes = march.sizes[np.searchsorted(stack.grid.numbers[1:-1], node, side="right"), 0]
    length = since / march.unit
    length[free] = (stack.times(node[free]) - stack.times(origin) + since[free]) / march.unit
    nodes = free & ~inside
    length[nodes] = sizes[nodes] * (node - unloaded.begin[segment])[nodes] if nodes.any() else 0.0
    lengths, begin = np.stack([length, np.full(n, 1.0 / march.unit)], axis=1), node.copy()
    begin[free] = origin
    own = _rows(march, begin, (inside | free).astype(np.int64), 0, lengths, np.arange(n))
    own[free, CALL.unloaded_from] = origin
    own[:, CALL.output_row], own[:, CALL.begins] = here + 1, np.isin(begin, stack.grid.numbers[1:-1])
    t, h = stack.times(node[is_step]), since[is_step]
    loads = march.samples_at(lambda: (t[:, None] + h[:, None] * middles).ravel(), lambda: (t, t + h, h), middles)
    own[is_step, CALL.times : CALL.output_row] = addresses(loads, march.count * np.arange(len(t)))
    rates = np.append(march.unit / outputs.length[here], np.ones(len(steps)))
    rows = np.concatenate([own, steps])
    order = np.argsort(rows[:, CALL.first], kind="stable")
    return rows[order], rates[order], (lengths, loads)
