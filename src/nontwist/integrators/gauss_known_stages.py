"""The equations of the stages of a step that is taken again, with derivatives (`gauss_derivatives`)."""

from __future__ import annotations

from typing import Any

from ..engine.known_steps import Directions, Known
from ..engine.linear_functions import Calls
from ..engine.records import Body
from ..kernels.memory import View, vector_at
from ..kernels.vectors import Matrix, Vector, cross
from .gauss_coefficients import TABLE
from .gauss_stages import ZEROS, Equations


class KnownStages(Known):
    """What acts at the stages of steps of which all is known; `nodes` returns the record of one."""

    def __init__(self, calls: Calls, body: Body, nodes: Any, scale: Any, directions: Directions) -> None:
        super().__init__(calls, body, nodes(0), scale, directions)
        self._nodes, self._steps = nodes, calls.block
        self.force = directions.along("force", Matrix(*(ZEROS,) * 3)) if "force" in directions.places else None

    @property
    def orbit(self) -> tuple[Any, Vector]:
        """The rate of the orbit, and its axis in space."""
        return self.vary.along("orbit", self._steps.orbit[0]), vector_at(self._steps.orbit, 1)

    def known(self, j: Any) -> Any:
        """Return what is known of a node."""
        return self._nodes(j)

    def fraction(self, j: Any) -> Any:
        """Return how far into the step a node is; seen from an orbit, no time passes in it."""
        return 0.0 if self.parts.orbit else self._steps.table[TABLE.nodes + j]

    def evaluate(self, i: Any, W: Vector, g: Any, is_sloped: bool) -> None:
        """Evaluate the functions of the state at a stage."""
        rows = self.R @ g
        self.calls.evaluate(self.known(i), self.basis @ rows.T, rows @ W, ZEROS, is_sloped)


class StageEquations(Equations):
    """The equations of the stages for the velocities V that vectors of space turn with."""

    nodes: KnownStages

    def evaluated(self, i: Any, stage: View, matrix: Any = TABLE.mu) -> tuple[Vector, Any, Any]:
        """Return P, the vectors g, and what the equations say at stages."""
        (P, g), nodes, parts = self.placed(i, matrix), self.nodes, self.parts
        loads = self.kept(stage)
        if parts.calls:
            nodes.evaluate(i, self.k * P, g, False)
            at = nodes.known(i)
            load = nodes.factor * (at.load @ nodes.R) if parts.function else None
            of_potentials = nodes.factor * (at.of_potentials @ nodes.basis) if parts.generalised else None
            loads = loads._replace(called=load, of_potentials=of_potentials)
        return P, g, self.now(loads, P, g)

    def orbital(self, g: Any) -> Vector:
        """Return the velocity of the orbit, n o, as seen from the body; 0 where there is none."""
        return -self.turning(ZEROS, g)

    def rate(self, i: Any, V: Vector, g: Any, C: Any) -> Vector:
        """Return V' at a stage, of numbers of any kind; C: the axes of b at the beginning as seen there."""
        nodes, W = self.nodes, V if self.orbit is None else V + self.orbital(g)
        body = nodes.body
        load, of_potentials = nodes.functions(i).torque(g, W) if self.parts.calls else (None, None)
        loads = self.sampled(i)._replace(called=load, of_potentials=of_potentials)
        x, y, z = self.now(loads, body.momentum_of(W), g).rate
        if nodes.force is not None:
            more = ZEROS
            for f, c in zip(Matrix(*map(nodes.seen, nodes.force)).T, C, strict=True):
                more = more + cross(f, c)
            x, y, z = x + more[0], y + more[1], z + body.free * more[2]
        if self.parts.spin:
            z = z + (body.E[0] + body.E[1]) * (nodes.spin(i) / nodes.h)
        rate = body.velocity_of(Vector(x, y, z))
        return rate if self.orbit is None else rate - cross(self.orbital(g), V)
