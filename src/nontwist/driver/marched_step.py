"""The step of a stepper that its kernels do not take: a run of one step, with all that a run does."""

from __future__ import annotations

from dataclasses import replace
from math import nan
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..integrators import IVP, Status
from ..integrators.base import Failure
from ..integrators.compiled import Compiled
from ..integrators.marching import ENDS, NUMBERS, Numbers, Vector, Wheels
from ..integrators.wheels import COMMANDED, commanded
from ..loads import Load
from ..loads.terms import Table
from ..models.stack import stacked
from ..models.system import DirectorSystem
from . import completion
from .contacts import refusal
from .planning import fitting


class MarchedStep:
    """The step of a body under dry friction, or with wheels that have friction: a run of one step."""

    def __init__(self, system: DirectorSystem, load: Load, step: float, scheme: Compiled) -> None:
        self.step, self.scheme, self._failed = step, scheme, Failure(Status.OK, 0, nan, nan)
        self.stack = IVP(stacked(system), np.eye(4)[3:], np.zeros((1, 3)), load, 0.0, step, 1, ENDS, intervals=True)
        fitting(load, scheme, self.stack.systems)
        if (reason := refusal(scheme, self.stack)) is not None:
            raise ValueError(reason)
        self._own, self._load = sum(one.count for one in load.wheels), commanded(load)

    def begin(self, problem: IVP) -> Numbers:
        """Return the numbers at the start of a problem, as `SingleStep` does."""
        z = [] if problem.internal is None else problem.internal[0, self._own :].tolist()
        return self._numbers(problem.quaternion[0], problem.velocity[0], 0.0, 0.0, z, 0.0)

    def __call__(
        self,
        numbers: Numbers,
        start: float,
        number: int,
        body: Vector,
        space: Vector,
        wheels: tuple[Wheels, Array] | None,
    ) -> tuple[Numbers, Wheels]:
        """Take a step, as `SingleStep` does."""
        t, h, load = start + number * self.step, self.step, self._load
        own, torques = wheels or ((), np.zeros(0))
        z = [x for one, torque in zip(own, torques.tolist(), strict=True) for x in (*one, torque)]
        z += numbers[NUMBERS.carried : (NUMBERS.carried + len(numbers)) // 2]
        around, frames = np.array([t - h, t + 2 * h]), ("body", "space")
        for frame, moment in zip(frames, (body, space), strict=True):
            if any(moment):
                load = load + Table(frame, around, np.array([moment, moment]))  # type: ignore[arg-type]
        begin: dict[str, Any] = {"quaternion": np.array([numbers[:4]]), "velocity": np.array([numbers[4:7]])}
        begin |= {"internal": np.array([z]) if z else None, "t_start": t, "t_end": t + h}
        outcome = completion.march(self.scheme, replace(self.stack, load=load, **begin))
        self._failed = (outcome.failure() or Failure(Status.OK, 0, nan, nan))._replace(step=number)
        end, means = outcome.states.part(0, -1), outcome.intervals
        assert means is not None
        z = [] if end.internal is None else end.internal.tolist()
        ends = tuple(tuple(z[COMMANDED * k :][:3]) for k in range(len(own)))
        mu = float(means.multipliers[0, 0, -1]) if self.stack.systems.axis is not None else 0.0
        work, rest = float(means.load_work[0, 0]), z[COMMANDED * len(own) :]
        return self._numbers(end.quaternion, end.velocity, mu, work, rest, self._failed.status), ends

    @staticmethod
    def _numbers(p: Array, W: Array, mu: float, work: float, z: list[float], status: float) -> Numbers:
        return (*p.tolist(), *W.tolist(), mu, work, *z, *(0.0 for _ in z), float(status))

    def failure(self, number: int) -> Failure | None:
        """Return why the step just taken failed, None where it did not."""
        return self._failed if self._failed.status else None
