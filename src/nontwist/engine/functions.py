"""What depends on the state as C functions: compiled ones, and those in Python behind a callback."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..loads import Load
from ..loads.base import state_moment_at
from ..loads.c_functions import Moment, address_of
from ..loads.compiled import c_function
from ..loads.forces import DirectorForces
from ..loads.potentials import GravityGradient, Potential, PotentialFunction, Quadratic, Spring
from ..loads.terms import REMEDY
from .generalised import FUNCTION, MOMENT, ORBITING, QUADRATIC, SPRING, TERM, generalised


class Called:
    """The terms of a load that are evaluated while a run marches.

    Attributes
    ----------
    address : int
        Of the moments of the state as one C function, 0 where there are none.
    generalised : int
        Of what makes moments of director forces and potentials (`generalised`), 0 where there are none.
    terms : int
        Of what it needs to know.
    error : exception or None
        What the last call of a function in Python raised.
    """

    def __init__(self, load: Load, action: int = MOMENT) -> None:
        self.load, self.address, self.generalised, self.terms = load.called, 0, 0, 0
        self._whole, self.action, self._kept = load, action, []
        self.error: BaseException | None = None
        if self.load.terms:
            parts: Any = tuple((term.compiled, term.scale) for term in self.load.terms if term.compiled is not None)
            if self.load.is_compiled:
                function = c_function(parts)
                self._kept.append(function)
                self.address = function.address
            else:
                self.address = self._callback(self._moment, 3)
        if any(isinstance(term, (DirectorForces, Potential)) for term in load.terms):
            self.generalised, laid_out = generalised.address, self._laid_out()
            self._kept.append(laid_out)
            self.terms = laid_out.ctypes.data

    def _callback(self, function: Any, count: int) -> int:
        """Return the address of a function in Python, which may raise and writes so many numbers."""

        def guarded(t: float, first: Any, second: Any, found: Any) -> None:
            try:
                function(t, first, second, found)
            except BaseException as error:  # it must not pass through the kernel
                self.error = error
                for k in range(count):
                    found[k] = np.nan

        callback = Moment(guarded)
        self._kept.append(callback)
        return address_of(callback)

    def _moment(self, t: float, directors: Any, angular_velocity: Any, moment: Any) -> None:
        q, w = np.array(directors[:9]).reshape(3, 3), np.array(angular_velocity[:3])
        moment[0], moment[1], moment[2] = state_moment_at(self.load, t, q, w).tolist()

    def _laid_out(self) -> Array:
        """Return what `generalised` needs to know, as numbers of 8 bytes."""
        forces = [term for term in self._whole.functions if isinstance(term, DirectorForces)]
        potentials = self._whole.potentials
        reals = np.zeros(2 + TERM.size * len(potentials))
        whole = reals.view(np.int64)
        whole[0], whole[1] = self._forces(forces) if forces else 0, len(potentials)
        for k, term in enumerate(potentials):
            place = 2 + TERM.size * k
            self._describe(term, reals[place : place + TERM.size], whole[place : place + TERM.size])
        return reals

    def _forces(self, terms: list[DirectorForces]) -> int:
        """Return the address of the sum of functions of director forces."""
        parts: Any = tuple((term.compiled, term.scale) for term in terms if term.compiled is not None)
        if len(parts) == len(terms):
            function = c_function(parts, 9)
            self._kept.append(function)
            return int(function.address)

        def forces(t: float, directors: Any, angular_velocity: Any, found: Any) -> None:
            q, w = np.array(directors[:9]).reshape(3, 3), np.array(angular_velocity[:3])
            total = sum((term.scale * term.forces(t, q, w) for term in terms), np.zeros((3, 3)))
            for k, number in enumerate(total.ravel().tolist()):
                found[k] = number

        return self._callback(forces, 9)

    def _describe(self, term: Potential, reals: Array, whole: Any) -> None:
        """Write a potential as `generalised.Term` has it."""
        vectors = term.vectors
        whole[TERM.dimension], reals[TERM.scale] = len(vectors), term.scale
        reals[TERM.vectors : TERM.vectors + vectors.size] = vectors.ravel()
        if isinstance(term, GravityGradient):
            whole[TERM.kind], whole[TERM.dimension], reals[TERM.stiffness] = ORBITING, 1, term.mean_motion
            reals[TERM.vectors : TERM.vectors + 6] = np.ravel([term.at_zero, np.cross(term.normal, term.at_zero)])
            reals[TERM.quadratic : TERM.square] = term.quadratic.ravel()
        elif isinstance(term, Quadratic):
            whole[TERM.kind] = QUADRATIC
            reals[TERM.linear : TERM.quadratic] = term.linear
            reals[TERM.quadratic : TERM.square] = term.quadratic.ravel()
        elif isinstance(term, Spring):
            whole[TERM.kind], reals[TERM.linear : TERM.quadratic] = SPRING, term.point
            reals[TERM.square], reals[TERM.stiffness] = term.square, term.stiffness
            reals[TERM.rest] = term.rest_length
        elif term.compiled is not None:
            whole[TERM.kind], whole[TERM.function] = FUNCTION, term.compiled.address  # type: ignore[attr-defined]
        else:
            whole[TERM.kind], whole[TERM.function] = FUNCTION, self._callback(_python(term), 1 + vectors.size)

    def reason(self, last: Array) -> str:
        """Return why the function has failed: what Python says at the state that it was called with `last`.

        That is 16 numbers: directors, angular velocity, moment, time.
        """
        if self.error is None:
            try:
                self._whole.state_moment(float(last[15]), last[:9].reshape(3, 3), last[9:12])
                self._whole.potential_energy(last[:9].reshape(3, 3))
            except ValueError as error:
                self.error = error
        return str(self.error or f"the load is not finite at t = {last[15]:.12g} s; {REMEDY}")

    def require_no_interrupt(self) -> None:
        """Raise what has interrupted a function in Python, Ctrl-C or `SystemExit`: it could not pass the kernel."""
        if self.error is not None and not isinstance(self.error, Exception):
            raise self.error


def _python(term: Potential) -> Any:
    """Return V and its gradient as a function like those of C."""
    assert isinstance(term, PotentialFunction)
    count = 3 * len(term.vectors)

    def both(t: float, gamma: Any, _: Any, found: Any) -> None:
        g = np.array(gamma[:count]).reshape(term.shape)
        numbers = [term.checked_value(g), *term.slope(g).ravel().tolist()]
        for k, number in enumerate(numbers):
            found[k] = number

    return both
