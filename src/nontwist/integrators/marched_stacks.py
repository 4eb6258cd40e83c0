"""From a stack of problems through its march (`stack_march`) to what comes out of it.

A `PreparedMarch` of one body is laid out once and called with starts, from many threads if need be. The loads are
sampled when the march is prepared. Each thread has memory of its own, with a block of addresses that point there. A
call writes the start into it, calls compiled code once (`engine.workspace`), and copies the results.

A `SingleStep` of one body goes from numbers to numbers: what a closed loop calls. A march over a grid of one step is
laid out once. A call writes the state that the step begins with and the moments at its nodes into that memory, runs the
kernel, and reads the state at the end back. So a step depends on what it is given alone: a state that is kept can be
given again, and a step that fails leaves nothing behind. The moments of the caller are constant over the step, in the
body and in space. The kernel is one for both kinds of moments whatever they are, so that moments of zero change no bit;
a run with a load in space has the same bits. Of a body with wheels it is the step of their carrier
(`load_samples.carrier`), the torques of their motors constant.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from math import inf
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..engine.records import BLOCK, BODY, QUANTITIES, STATE, SUMS, WORK, layout, pack, side_by_side, views
from ..engine.workspace import PREPARED, enter, run_prepared
from ..exact.free_bodies import TOO_FAR
from ..geometry.arrays import Array
from ..geometry.attitudes import States
from ..kernels import machine_code
from ..loads import Load
from ..loads.memory_terms import Wheel
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from .compiled import Compiled
from .ivp import IVP, Failure, Intervals, Outcome, Status
from .load_samples import COMMANDED, WIDTHS, beside_chord, carrier, commanded, wheel_columns, work_of
from .stack_march import SAME, StackMarch, listed, march_of
from .stepping import PerThread

NONE = np.zeros(0)
KEPT_NODES = 2**11  # at most, of marches that are kept

if TYPE_CHECKING:
    from .dense import Dense, PreparedDense


def dense_of(problem: IVP, scheme: Compiled) -> Dense | None:
    """Return what finds outputs between nodes, where these lie on one trajectory; None where they are substeps."""
    if problem.output_times is None or not scheme.has_series(problem.systems, problem.load):
        return None
    from .dense import Dense

    return Dense(problem, scheme)


def march_stack(problem: IVP, threads: int, scheme: Compiled, can_be_dense: bool = True) -> Outcome:
    """March a stack; a member that fails keeps its good states."""
    if not scheme.is_director_scheme:
        problem = on_constraint(problem)
    if can_be_dense and (known := _by_kept_march(problem, scheme)) is not None:
        return known
    dense = dense_of(problem, scheme) if can_be_dense else None
    todo = march_of(problem, scheme) if dense is None else dense.march
    common, end = None, None
    if todo is not problem.marched:
        if problem.memory is not None:
            todo.resume(problem.memory)
        common, end = todo.run(threads)
    arrays, reasons, k = todo.arrays, dict[int, str | Exception](), len(todo.stack.stored_times)
    failures = arrays["failures"]
    good, is_one = np.full(len(problem), k), len(problem) == 1 and not problem.on_gpu

    if common is not None:
        running = failures[:, 0] == Status.OK
        failures[running] = common[:4]
        reasons = dict.fromkeys(np.flatnonzero(running).tolist(), common.reason)
    for i in np.flatnonzero(failures[:, 0]).tolist():
        good[i] = todo.good(int(failures[i, 1])) + (end is not None)
        is_stalled = failures[i, 0] == Status.STALLED and isinstance(todo.functions.error, Exception)
        if scheme.is_exact_without_load and failures[i, 0] == Status.TURN and np.isnan(failures[i, 3]):
            reasons[i] = TOO_FAR  # the motion without load, so far that no digit of it is left
        elif is_stalled or (failures[i, 0] == Status.LOAD and i not in reasons):  # nearby the load may have a value
            if is_one:
                failures[i, 0], reasons[i] = Status.LOAD, todo.functions.reason(todo.last_call)
            else:
                alone = march_stack(replace(problem.member(i), on_gpu=False), 1, scheme)
                failures[i, 0], reasons[i] = alone.failures[0, 0] or Status.LOAD, alone.reasons.get(0, "")
    first = todo.skipped
    if dense is not None:
        if end is None and common is not None and common.status is Status.INTERRUPTED and common.step:
            end = common.step  # a node, and seldom an output
        if (outputs := dense.outputs(good, end)) is None:
            return march_stack(problem, threads, scheme, False)
        (arrays, good), first = outputs, dense.skipped
    intervals = intervals_in(todo, arrays, first) if problem.intervals else None
    observed = _observed(todo) if problem.observed else None
    states, is_kept = states_in(arrays, first), len(problem) == 1  # what many carry would take most of the memory
    carried, kept = (todo.arrays["states"] * todo.factors, todo) if is_kept else (None, None)
    return Outcome(states, good, failures, reasons, intervals, observed, carried, end, kept)


class Marched(NamedTuple):
    """A run by a march that is kept: the march, its factor of the load, the numbers found, the sum of their squares."""

    march: PreparedMarch
    scale: float
    numbers: Array
    squares: float


def _by_kept_march(problem: IVP, scheme: Compiled) -> Outcome | None:
    """Return the outcome of a plain run, whose march is laid out once for all starts; None for others, and failures."""
    load, known, done = problem.load, problem.output_times, problem.marched
    if isinstance(done, Marched):
        if known is None or not scheme.has_series(problem.systems, load):
            return None
        dense = _kept_outputs(done.march, known.tobytes(), problem.intervals)
        found, first = dense.outputs(done.numbers, done.scale), dense.skipped
        if found is None:
            return march_stack(problem, 1, scheme, False)
        arrays = found
    else:
        parts = problem.memory, problem.normal, problem.progress, known
        is_plain = len(problem) == 1 and all(part is None for part in parts) and load.is_immutable
        size = max(problem.steps * scheme.nodes, len(problem.stored))
        if not is_plain or problem.on_gpu or problem.observed or size > KEPT_NODES or not scheme.can_prepare(load):
            return None
        scale, span, stored = problem.load_scale.item(), (problem.t_start, problem.t_end), problem.stored.tobytes()
        how = scale, (*span, problem.steps), problem.segments, stored, problem.intervals
        kept = _kept_march(scheme, problem.systems, load, *how)
        kept.expect(problem.steps)
        numbers, squares, _ = kept(problem.quaternion[0], problem.velocity[0], scale)
        if not squares < inf:
            return None
        done, first = Marched(kept, scale, numbers, squares), 0
        arrays = views(numbers, kept.march.slab)
    todo, states = done.march.march, states_in(arrays, first)
    intervals = intervals_in(todo, arrays, first) if problem.intervals else None
    carried = done.numbers[todo.slab["states"][0]] * done.march.factors
    good = np.array([states.quaternion.shape[1]])
    return Outcome(states, good, np.zeros((1, 4)), {}, intervals, None, carried[None], None, done)


@lru_cache(maxsize=64)
def _kept_march(
    scheme: Compiled, systems: SystemStack, load: Load, scale: float, span: Any, grid: Any, stored: bytes, means: bool
) -> PreparedMarch:
    at, start = np.frombuffer(stored, np.int64).copy(), (np.eye(4)[3:], np.zeros((1, 3)))
    parts: Any = systems, *start, load, *span, at, np.array([scale])
    return PreparedMarch(StackMarch(replace(IVP(*parts), intervals=means, segments=grid), scheme), 0)


@lru_cache(maxsize=16)
def _kept_outputs(kept: PreparedMarch, times: bytes, means: bool) -> PreparedDense:
    from .dense import Dense, PreparedDense

    march = kept.march
    problem = replace(march.stack, output_times=np.frombuffer(times).copy(), intervals=means, marched=march)
    return PreparedDense(problem, Dense(problem, march.scheme), kept)


def on_constraint(problem: IVP) -> IVP:
    """Return the problem with tangent velocities and the spin that the constraint prescribes, round-off of it apart."""
    W, axis, systems = problem.velocity, problem.systems.axis, problem.systems
    if axis is None and problem.normal is None:
        return problem
    if axis is not None and systems.spin is not None:
        rate = systems.spin_at(problem.t_start)[:, None] - (W * axis).sum(axis=1, keepdims=True)
        W = W + rate * axis
    elif axis is not None:
        spin = (W * axis).sum(axis=1, keepdims=True)
        W = np.where(abs(spin) > SAME * abs(W).max(axis=1, keepdims=True), W - spin * axis, W)
    return replace(problem, velocity=W, normal=None)


def states_in(arrays: dict[str, Array], first: int) -> States:
    """Return the stored states in the arrays of a march, or in those of one member, from number `first` on."""
    p, W, N = (arrays[name] for name in ("quaternions", "velocities", "normals"))
    z = arrays.get("internals", NONE)
    normal, internal = (array[..., first:, :] if array.size else None for array in (N, z))
    return States(p[..., first:, :], W[..., first:, :], normal, internal=internal)


def intervals_in(todo: StackMarch, arrays: dict[str, Array], first: int) -> Intervals:
    """Return the means in the arrays of a march, or in those of one member, from interval `first` on.

    The moment of all forces of a potential is not summed where it is needed, on constrained bodies. The twist of a body
    that is not constrained is not counted where it moves exactly.
    """
    sums, is_constrained = arrays["intervals"][..., first:, :], todo.stack.systems.axis is not None
    begin = SUMS.lam if todo.scheme.is_director_scheme else SUMS.mu
    means = sums[..., begin : SUMS.moment if is_constrained else SUMS.mu], sums[..., SUMS.moment : SUMS.dead]
    dead = None if is_constrained and todo.load.potentials else sums[..., SUMS.dead : SUMS.work]
    twist = sums[..., SUMS.twist] if is_constrained or not todo.scheme.is_exact_without_load else None
    velocity_integrals = sums[..., SUMS.velocity_integral : SUMS.twist] if todo.parts.integrates_velocity else None
    iterations = sums[..., SUMS.iterations].astype(np.int64)
    return Intervals(*means, sums[..., SUMS.work], iterations, dead, twist, velocity_integrals=velocity_integrals)


def _observed(todo: StackMarch) -> Array:
    """Return what was observed in the units of the caller, (m, 4, QUANTITIES); NaN for members that have failed."""
    moment, T = todo.bodies[:, BODY.unit, None], todo.unit
    units = np.repeat(moment, QUANTITIES, axis=1)
    units[:, 3:9] *= T
    units[:, 9], units[:, 10] = 1 / T, units[:, 10] * T
    found = todo.arrays["observed"][:, :-1].reshape(-1, 4, QUANTITIES)
    found = found * np.stack([units, units, units, units * T], axis=1)
    found[todo.arrays["failures"][:, 0] != Status.OK] = np.nan
    return found


READ = "quaternions", "velocities", "normals", "intervals", "states"
START, FOUND = Struct("=8d"), Struct("=2d")


class PreparedMarch:
    """The march of one body whose start is left open; `work`: how many steps its calls will take."""

    def __init__(self, march: StackMarch, work: float = inf) -> None:
        self.march, (parts,), self._work = march, march.groups, work
        march.sample(parts, 0, march.stack.steps)
        self._todo = listed(march, parts, 1, 0, march.stack.steps, work=work)
        self._unit, self._run = float(march.bodies[0, BODY.unit]), run_prepared.function
        self.factors = march.factors[0]
        self._slab = {name: (part, shape[1:] or shape) for name, (part, shape) in march.slab.items() if name in READ}
        self._threads = PerThread(self._workspace)

    def expect(self, steps: int) -> None:
        """Take better code where so many more steps are worth it."""
        before, self._work = self._work, self._work + steps
        if before < machine_code.ENOUGH <= self._work:
            self._todo = listed(self.march, self.march.groups[0], 1, 0, self.march.stack.steps, work=self._work)
            self._threads = PerThread(self._workspace)

    def __call__(self, p: Any, W: Any, scale: float) -> tuple[Array, float, float]:
        """March from the quaternion `p`, scalar last, and W.

        Return the numbers found, for `read`, the sum of their squares, infinite where the run has failed, and the
        largest |W|² of the stored states.
        """
        memory, own, address, _ = self._threads.own
        START.pack_into(own, 8 * PREPARED.p, *p, *W, scale / self._unit)
        self._run(address)
        return memory.copy(), *FOUND.unpack_from(own, 8 * PREPARED.squares)

    def read(self, found: Array) -> dict[str, Any]:
        """Return the states of a run from the numbers found; its `_read` returns the rest."""
        arrays = views(found, self._slab)
        return {"states": states_in(arrays, self.march.skipped), "_read": partial(self._rest, arrays)}

    def _rest(self, arrays: dict[str, Array]) -> dict[str, Any]:
        means = intervals_in(self.march, arrays, self.march.skipped)._asdict()
        del means["velocity_integrals"]  # of motors, which are not prepared
        return means | {"memory": arrays["states"] * self.factors}

    @property
    def states(self) -> States:
        """The states of the last call of this thread, in memory that its next call overwrites."""
        return self._threads.own[3][0]

    def _workspace(self) -> tuple[Array, memoryview, int, Any]:
        """Return memory for one thread: results, `Prepared`, its address, all of it."""
        march, (arrays, array_addresses) = self.march, side_by_side(**self.march.shapes)
        memory, own = arrays["quaternions"].base, np.zeros(PREPARED.size, dtype=np.int64)
        assert memory is not None
        block, *keepalive = march.laid(self._todo)
        pack(block, BLOCK, **array_addresses, scales=own[PREPARED.factor :])
        run = self._todo.driver.address
        begin = machine_code.pointer_address(enter.function_for(self._work))
        pack(own, PREPARED, block=block, numbers=len(memory), enter=begin, run=run)
        states = states_in(arrays, march.skipped).part(0)
        return memory, own.data.cast("B"), own.ctypes.data, (states, block, keepalive)


Numbers = tuple[float, ...]
Vector = tuple[float, float, float]
Wheels = tuple[tuple[float, ...], ...]  # of each its momentum, the work of its motor, and what friction has taken

# What a step gives: the quaternion, scalar last; W; means μ and sum of the work over the step; the state as carried.
NUMBERS = layout(quaternion=4, velocity=3, mu=1, work=1, march_state=STATE.size, status=1)
ENDS = np.array([0, 1])


class SingleStep:
    """The step of a scheme for one body, with memory of its own: one thread at a time may call it."""

    def __init__(self, system: DirectorSystem, load: Load, step: float, scheme: Compiled) -> None:
        self.system, self.load, self.step, self.scheme = system, load, step, scheme
        at_identity, still, grid = np.eye(4)[3:], np.zeros((1, 3)), (0.0, step, 1, ENDS)
        if load.wheels:
            terms = (one for one in load.terms if not (isinstance(one, Wheel) and one.is_driven))
            system, load = carrier(system, load), commanded(Load(tuple(terms)))
        self._driven = [k for k, one in enumerate(self.load.wheels) if one.is_driven]
        self._locked = sum((one.locked for one in self.load.wheels), np.zeros((3, 3)))
        self._axes = np.array([self.load.wheels[k].direction for k in self._driven]).reshape(-1, 3)
        self._inertia = np.array([self.load.wheels[k].inertia for k in self._driven])[:, None]
        self._own = [k for k, one in enumerate(self.load.wheels) if not one.is_driven]
        self.stack = IVP(stacked(system), at_identity, still, load, *grid, normal=np.zeros((1, 6)), intervals=True)
        scheme.require(self.stack)
        has_rotors = bool(self.load.rotors or self._driven)
        known = {"integrates_velocity": True} if self._driven else {}
        march = self._march = StackMarch(self.stack, scheme, moving=True, space=True, rotor=has_rotors, **known)
        (parts,) = march.groups
        march.sample(parts, 0, 1)
        self._middles, self._functions = march.stages[parts][1], march.functions
        count = self._count = march.count
        nodes = np.zeros((2, count, 3))  # moments in the body and in space
        varies = march.parts.spin
        self._is_loaded = bool(march.load.terms) or varies
        own = {"times": np.zeros(count), "moving": nodes[0], "space": nodes[1], "forces": march.loads[3]}
        own |= {"rotor": np.zeros((count, 6)) if has_rotors else None, "spin": np.zeros(count) if varies else None}
        march.loads = tuple(own.values())
        todo = listed(march, parts, 1, 0, 1, work=inf)
        block, self._workspace, keepalive = march.laid(todo)
        self._alive = block, keepalive
        self._run, self._address = todo.driver.function, block.ctypes.data
        owner: Any = march.arrays["quaternions"].base  # all arrays of a march lie in one piece of memory
        self._memory, self._moments = owner.data.cast("B"), nodes.data.cast("B")
        self._constant = Struct(f"{6 * self._count}d")
        at = {name: part.start for name, (part, _) in march.slab.items()}
        means, march_state = at["intervals"], (at["states"], march.shapes["states"][1])
        rest = (means + SUMS.mu, 1), (means + SUMS.work, 1), march_state, (at["failures"], 1)
        self._read = _struct_of((4, 4), (at["velocities"] + 3, 3), *rest)
        self._velocity_integrals = slice(means + SUMS.velocity_integral, means + SUMS.twist)
        # The quaternion goes where that of the node before is: the kernel gives the next one its sign. What lies
        # between is the kernel's to write, or zeros.
        self._written = _struct_of((0, 4), (at["velocities"], 3), *rest, (at["sums"] + SUMS.size, 0))

    def begin(self, problem: IVP) -> Numbers:
        """Return the numbers at the start of a problem; nothing but its body, start and memory is looked at."""
        march, director = self._march, self.scheme.is_director_scheme
        if problem.internal is not None and self.load.wheels:
            z, size = problem.internal[0].tolist(), sum(one.count for one in self.load.wheels)
            starts = [place for one, place in wheel_columns(self.load) if not one.is_driven]
            own = [x for place in starts for x in (*z[place : place + 3], 0.0)] + z[size:]
            problem = replace(problem, internal=np.array([own]) if own else None)
        march.begin(problem if director else on_constraint(problem))
        if problem.memory is not None:
            march.resume(problem.memory)
        p, W, march_state = (march.arrays[name].ravel().tolist() for name in ("quaternions", "velocities", "states"))
        return (*p[:4], *W[:3], 0.0, 0.0, *march_state, 0.0)

    def __call__(
        self,
        numbers: Numbers,
        start: float,
        number: int,
        body: Vector,
        space: Vector,
        wheels: tuple[Wheels, Array] | None = None,
    ) -> tuple[Numbers, Wheels]:
        """Take the step of this `number`, which begins `number` steps after `start`; `status` is 0 unless it failed.

        `wheels` are what they have at the beginning, and torques beside those of the load.

        Raises
        ------
        ValueError
            The load fails at the times of this step.
        """
        self._constant.pack_into(self._moments, 0, *body * self._count, *space * self._count)
        if self._is_loaded:
            march, h, middles = self._march, self.step, self._middles

            def ends() -> tuple[Array, Array, Array]:
                begin, end = start + np.array([[number], [number + 1]]) * h
                return begin, end, np.array([h])

            found = march.samples_at(lambda: start + (number + middles) * h, ends, middles)
            for name, array, more in zip(WIDTHS, march.loads, found, strict=True):
                if array is not None and more is not None:
                    array[...] = array + more if name in ("moving", "space") else more
        if wheels is None:
            self._written.pack_into(self._memory, 0, *numbers)
            self._run(self._address)
            return self._read.unpack_from(self._memory), ()
        return self._with_wheels(numbers, start + number * self.step, *wheels)

    def _with_wheels(self, numbers: Numbers, t: float, begin: Wheels, torque: Array) -> tuple[Numbers, Wheels]:
        """Take a step with wheels: the momenta of some are known beforehand, and others are internal states."""
        march, h, wheels, given = self._march, self.step, self.load.wheels, list(numbers)
        states = len(numbers) - 1 - 2 * march.load.internal_state.size
        for i, k in enumerate(self._own):
            given[states + COMMANDED * i + 3] = float(torque[k])
        self._written.pack_into(self._memory, 0, *given)
        times, own = np.array([t, t + h]), [wheels[k] for k in self._driven]
        impulse = h * torque[self._driven] + [one.scale * np.diff(one.impulse(times))[0] for one in own]
        momenta = np.array([begin[k][0] for k in self._driven])
        if own:
            c, rate = momenta @ self._axes, impulse / h @ self._axes
            found = np.column_stack([c + np.outer(self._middles * h, rate), [rate] * self._count])
            if self._count > 1 and any(one.times.size for one in own):
                torques = np.array([one.scale * one.torque_at(t + self._middles * h) for one in own])
                found += beside_chord((torques.T @ self._axes)[None], np.array([h]), self._middles)[0]
            found[:, :3] /= march.unit
            rotor: Any = march.loads[4]
            rotor[...] = found if not self.stack.load.rotors else rotor + found
            march.loads[0][...] = t + self._middles * h  # type: ignore[index]
        self._run(self._address)
        ended, ends = self._read.unpack_from(self._memory), list(begin)
        W, V = np.array(numbers[4:7]), np.array(ended[4:7])
        more = float((V - W) @ self._locked @ (V + W)) / 2  # what the wheels take, turning with the body
        ended = (*ended[: NUMBERS.work], ended[NUMBERS.work] + more, *ended[NUMBERS.march_state :])
        for i, k in enumerate(self._own):
            ends[k] = ended[states + COMMANDED * i :][:3]
        if own:
            slope = np.array([one.scale * one.slope_of_torque(times) for one in own])
            along = self._axes @ march.arrays["quaternions"].base[self._velocity_integrals].reshape(2, 3).T  # type: ignore[index]
            reached = np.stack([momenta, momenta + impulse], axis=1)
            works = work_of(self._inertia, times, reached, slope, impulse[:, None], along[:, :1], along[:, 1:])
            for k, momentum, work in zip(self._driven, reached[:, 1].tolist(), works[:, 0].tolist(), strict=True):
                ends[k] = momentum, begin[k][1] + work, 0.0
        return ended, tuple(ends)

    def failure(self, number: int) -> Failure | None:
        """Return why the step just taken failed, None where it did not.

        Raises
        ------
        KeyboardInterrupt, SystemExit
            What interrupted a load in Python.
        """
        status, _, residual, turn = self._march.arrays["failures"][0].tolist()
        functions = self._functions
        try:
            functions.require_no_interrupt()
            if status == Status.LOAD or functions.error is not None:
                reason = functions.reason(self._workspace[WORK.state_call :])
                return Failure(Status.LOAD, number, residual, turn, reason)
            return Failure(Status(int(status)), number, residual, turn) if status else None
        finally:
            functions.error = None


def _struct_of(*spans: tuple[int, int]) -> Struct:
    """Return the layout of spans of doubles, each a place and a count, in the order of their places."""
    text, end = "=", 0
    for place, count in spans:
        text += f"{8 * (place - end)}x{count}d"
        end = place + count
    return Struct(text)
