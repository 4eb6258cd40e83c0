"""One step of one body, from numbers to numbers: what a closed loop calls.

A march of a stack of one over a grid of one step (`stack_march`) is laid out once. A call writes the state that the
step begins with and the moments at its nodes into that memory, runs the kernel, and reads the state at the end back. So
a step depends on what it is given alone: a state that is kept can be given again, and a step that fails leaves nothing
behind. The moments of the caller are constant over the step, in the body and in space. The kernel is one for both kinds
of moments whatever they are, so that moments of zero change no bit; a run with a load in space has the same bits. Of a
body with wheels it is the step of their carrier (`wheels`), the torques of their motors constant.
"""

from __future__ import annotations

from struct import Struct
from typing import Any

import numpy as np

from ..engine.records import STATE, SUMS, WORK, layout
from ..geometry.arrays import Array
from ..loads import Load
from ..models.stack import stacked
from ..models.system import DirectorSystem
from .base import IVP, Failure, Status
from .compiled import Compiled
from .load_samples import WIDTHS
from .marching import tangent
from .stack_march import StackMarch, listed
from .wheels import carrier

Numbers = tuple[float, ...]
Vector = tuple[float, float, float]

# What a step gives: the quaternion, scalar last; W; means μ and sum of the work over the step; the state as carried.
NUMBERS = layout("Numbers", quaternion=4, velocity=3, mu=1, work=1, carried=STATE.size, status=1)
ENDS = np.array([0, 1])


class SingleStep:
    """The step of a scheme for one body, with memory of its own: one thread at a time may call it."""

    def __init__(self, system: DirectorSystem, load: Load, step: float, scheme: Compiled) -> None:
        self.system, self.load, self.step, self.scheme = system, load, step, scheme
        at_identity, still, grid = np.eye(4)[3:], np.zeros((1, 3)), (0.0, step, 1, ENDS)
        if load.wheels:
            system, load = carrier(system, load), load.without_wheels
        self.stack = IVP(stacked(system), at_identity, still, load, *grid, normal=np.zeros((1, 6)), intervals=True)
        scheme.require(self.stack)
        has_rotors = bool(self.load.rotors or self.load.wheels)
        march = self._march = StackMarch(self.stack, scheme, moving=True, space=True, rotor=has_rotors)
        (parts,) = march.groups
        march.sample(parts, 0, 1)
        self._middles, self._called = march.stages[parts][1], march.called
        count = self._count = march.count
        nodes = np.zeros((2, count, 3))  # moments in the body and in space
        varies = march.parts.spin
        self._is_loaded = bool(march.load.terms) or varies
        own = {"times": np.zeros(count), "moving": nodes[0], "space": nodes[1], "forces": march.loads[3]}
        own |= {"rotor": np.zeros((count, 6)) if has_rotors else None, "spin": np.zeros(count) if varies else None}
        march.loads = tuple(own.values())
        todo = listed(march, parts, 1, 0, 1)
        block, self._workspace, alive = march.laid(todo)
        self._alive = block, alive
        self._run, self._address = march.driver(todo).function, block.ctypes.data
        owner: Any = march.arrays["quaternions"].base  # all arrays of a march lie in one piece of memory
        self._memory, self._moments = owner.data.cast("B"), nodes.data.cast("B")
        self._constant = Struct(f"{6 * self._count}d")
        at = {name: part.start for name, (part, _) in march.spans.items()}
        means, carried = at["intervals"], (at["states"], march.shapes["states"][1])
        rest = (means + SUMS.mu, 1), (means + SUMS.work, 1), carried, (at["failures"], 1)
        self._read = _places((4, 4), (at["velocities"] + 3, 3), *rest)
        # The quaternion goes where that of the node before is: the kernel gives the next one its sign. What lies
        # between is the kernel's to write, or zeros.
        self._written = _places((0, 4), (at["velocities"], 3), *rest, (at["sums"] + SUMS.size, 0))

    def begin(self, problem: IVP) -> Numbers:
        """Return the numbers at the start of a problem; nothing but its body, start and memory is looked at."""
        march, director = self._march, self.scheme.is_director_scheme
        march.begin(problem if director else tangent(problem))
        if problem.memory is not None:
            march.remember(problem.memory)
        p, W, carried = (march.arrays[name].ravel().tolist() for name in ("quaternions", "velocities", "states"))
        return (*p[:4], *W[:3], 0.0, 0.0, *carried, 0.0)

    def __call__(
        self,
        numbers: Numbers,
        start: float,
        number: int,
        body: Vector,
        space: Vector,
        wheels: tuple[Array, Array] | None = None,
    ) -> Numbers:
        """Take the step of this `number`, which begins `number` steps after `start`; `status` is 0 unless it failed.

        `wheels` are the sum of their momenta at the beginning, (3,), and its rate.

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

            found = march.sampled_at(lambda: start + (number + middles) * h, ends, middles)
            for name, array, more in zip(WIDTHS, march.loads, found, strict=True):
                if array is not None and more is not None:
                    array[...] = array + more if name in ("moving", "space") else more
        if wheels is not None:
            c, rate = wheels
            rotor: Any = self._march.loads[4]
            momenta = (c + np.outer(self._middles * self.step, rate)) / self._march.unit
            own = np.column_stack([momenta, [rate] * self._count])
            rotor[...] = own if not self.stack.load.rotors else rotor + own
        self._written.pack_into(self._memory, 0, *numbers)
        self._run(self._address)
        return self._read.unpack_from(self._memory)

    def failure(self, number: int) -> Failure | None:
        """Return why the step just taken failed, None where it did not.

        Raises
        ------
        KeyboardInterrupt, SystemExit
            What interrupted a load in Python.
        """
        status, _, residual, turn = self._march.arrays["failures"][0].tolist()
        called = self._called
        try:
            called.require_no_interrupt()
            if status == Status.LOAD or called.error is not None:
                reason = called.reason(self._workspace[WORK.state_call :])
                return Failure(Status.LOAD, number, residual, turn, reason)
            return Failure(Status(int(status)), number, residual, turn) if status else None
        finally:
            called.error = None


def _places(*spans: tuple[int, int]) -> Struct:
    """Return the layout of spans of doubles, each a place and a count, in the order of their places."""
    text, end = "=", 0
    for place, count in spans:
        text += f"{8 * (place - end)}x{count}d"
        end = place + count
    return Struct(text)
