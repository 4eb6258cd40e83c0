"""Loads with memory at the stages of a step of `gauss` (`gauss_stages`).

Their internal states z are unknowns of the stages, as P and the rows are. With M a moment along the
moving frame and m one in space,

    z' = f(t, z, Λ, w),        P' = P × W + M(t, z, Λ, W) + Λ⁻¹ m(t, z, Λ, w) + ...,

and ``Z_i = z_n + h Σ a_ij f_j``, ``z_{n+1} = z_n + h Σ b_j f_j`` with the coefficients of P: collocation of the whole
system, of order 2s. So a bilinear function of the rows, P and z does along a step what it does along the motion
(`gauss`). A part that turns in the body with the momentum n z, on which the moment f acts, acts on the body by

    M = n z × W - n f,    so    (c_k·(P + n z))' = (c_k × W)·(P + n z) + c_k·((P + n z) × W) = 0 :

Λ (P + n z), of both together, is kept to round-off. This needs the W of the stage, which ``Λᵀ w`` is not where the rows
are not orthonormal. So what acts along the moving frame gets W.

The increments ``h b_j f_j`` follow by fixed points like those of the rows, where h |∂f/∂z| is below some 2s, otherwise
by Newton's iteration together with P (`gauss_newton`). Changes count relative to the scale of z, or to z where it is
larger.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..engine.internal import call_all
from ..engine.sampling import DIFFERENCE, Nodes
from ..engine.workspace import internal
from ..kernels.control import Variables, loop
from ..kernels.elements import fma, larger, select
from ..kernels.memory import View, put, scratch, size_of, vector_at
from ..kernels.vectors import Matrix, Vector
from ..loads.functions import MOMENTS
from ..loads.memory_terms import STATE
from .gauss_coefficients import TABLE, WIDTH
from .gauss_stages import INFINITE, OVERFLOW, Stage, Stages


class StageMemory:
    """The internal states z at the stages of a step: increments, z, and z', behind all else that is known of a stage.

    One body is marched at a time.
    """

    def __init__(self, nodes: Nodes, stages: Stages) -> None:
        self.nodes, self.stages, self.count, block = nodes, stages, nodes.parts.memory, nodes.block
        self.start, self.scales, self.functions = internal(block), block.internal_scales, block.responses
        self.h, first = nodes.h / nodes.rate, size_of(Stage)
        self._increment, self._z, self._rate = (first + k * self.count for k in range(3))

    def increment(self, stage: View, c: Any) -> Any:
        """Return the increment of the number c of z at a stage."""
        return stage.number(self._increment + c)

    def set_increment(self, stage: View, c: Any, x: Any) -> None:
        """Set it."""
        stage.set_number(self._increment + c, x)

    def rate(self, stage: View, c: Any) -> Any:
        """Return the last z' at a stage."""
        return stage.number(self._rate + c)

    def size(self, stage: View, c: Any) -> Any:
        """Return what changes count relative to: z at a stage, at least its scale."""
        return larger(abs(stage.number(self._z + c)), self.scales[c])

    def change(self, stage: View, c: Any) -> Any:
        """Return the difference of z of Newton's iteration."""
        return DIFFERENCE * self.size(stage, c)

    @contextmanager
    def changed(self, stage: View, c: Any) -> Iterator[None]:
        """Change the number c of z at a stage by its difference; none if c < 0."""
        k = larger(c, 0)
        z = stage.number(self._z + k)
        stage.set_number(self._z + k, z + select(c >= 0, self.change(stage, k), 0.0))
        yield
        stage.set_number(self._z + k, z)

    def clear(self) -> None:
        """Begin with increments of zero."""
        for _, stage in self.stages.each():
            for c in loop(self.count):
                self.set_increment(stage, c, 0.0 * stage.axial)

    def update_states(self, matrix: Any = TABLE.mu) -> None:
        """Set z at all stages from the increments."""
        stages = self.stages
        for i, stage in stages.each():
            for c in loop(self.count):
                sums = [0.0 * self.h, 0.0 * self.h]
                for j in range(stages.number):
                    a, dz = stages.coefficient(matrix + WIDTH * j, i), self.increment(stages.one(j), c)
                    sums[j % 2] = fma(a, dz, sums[j % 2])
                stage.set_number(self._z + c, self.start[c] + (sums[0] + sums[1]))

    def evaluate(self, j: Any, t: Any, d: Matrix, w: Vector, W: Vector) -> tuple[Vector, Vector, Any]:
        """Set z' at a stage; return the moments in space and along the frame, and 0, NaN where z' is not finite."""
        stage, given, v = self.stages.one(j), scratch(STATE), Variables(zero=0.0 * t)
        z, found = scratch(self.count), scratch(MOMENTS + self.count)
        put(given, (*d, w, W))
        for c in loop(self.count):
            z[c] = stage.number(self._z + c)
        call_all(self.functions, MOMENTS, self.count, t, given, z, found)
        for c in loop(self.count):
            rate = found[MOMENTS + c]
            stage.set_number(self._rate + c, rate)
            v.zero = v.zero + 0.0 * rate
        return vector_at(found), vector_at(found, 3), v.zero

    def follow(self, i: Any, stage: View) -> Any:
        """Take the increments that follow from z'; return the largest change."""
        b = self.h * self.stages.coefficient(TABLE.weights, i)
        v = Variables(change=0.0 * b)
        for c in loop(self.count):
            after = b * self.rate(stage, c)
            d = abs(after - self.increment(stage, c)) / self.size(stage, c)
            v.change = larger(v.change, select(d <= OVERFLOW, d, INFINITE))
            self.set_increment(stage, c, after)
        return self.stages.largest(v.change)

    def end(self) -> None:
        """Set the change in the step."""
        for c in loop(self.count):
            dz = [self.increment(self.stages.one(j), c) for j in range(self.stages.number)]
            self.start[2 * self.count + c] = sum(dz[1:], dz[0])
