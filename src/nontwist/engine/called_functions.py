"""What depends on the state as C functions: compiled ones, and those in Python behind a callback."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np

from ..errors import warn
from ..geometry.arrays import Array
from ..kernels.machine_code import pointer_address
from ..loads import Load
from ..loads.functions import REMEDY, SMALLER, Moment
from ..loads.load import state_moment_at
from ..loads.load_derivatives import changes_of_field, differenced, slopes_of, value_of
from ..loads.potentials import GravityGradient, Potential, Quadratic, Spring
from ..loads.terms import ForceTerm, Term
from .generalised import FUNCTION, MOMENT, OF_FORCES, OF_MOMENT, ORBITING, QUADRATIC, SPRING, TERM, generalised
from .records import CALLED, pack

KEPT = 8  # states whose derivatives are kept
FUNCTIONS = (FUNCTION, OF_FORCES, OF_MOMENT)  # kinds of terms whose texts are called


class StateFunctions:
    """The terms of a load that are evaluated while a run marches.

    Attributes
    ----------
    moments, responses : array or None
        How many functions give moments of the state, and terms with memory; each as `records.Called`.
    generalised : int
        Of what makes moments of director forces and potentials (`generalised`), 0 where there are none.
    terms : int
        Of what it needs to know.
    error : exception or None
        What the last call of a function in Python raised.
    """

    def __init__(self, load: Load, action: int = MOMENT) -> None:
        self.load, self.moments, self.responses, self.generalised, self.terms = load.called, None, None, 0, 0
        self._whole, self.action, self.keepalive = load, action, list[Any]()
        self.error: BaseException | None = None
        if self.load.terms:
            together: Any = [(PythonFunction(self._moment, 3), 1.0, 0)]
            parts = [(term.c_function, term.scale, 0) for term in self.load.terms]
            self.moments = self._list(parts if self.load.is_compiled else together)
        if load.memories:
            self.responses = self._list(
                [(one.c_function or evaluated(one), one.scale, one.state0.size) for one in load.memories]
            )
        if any(isinstance(term, ForceTerm) for term in load.terms):
            self._lay_out([*(term for term in load.functions if term.kind == "forces"), *load.potentials])

    def _list(self, functions: Sequence[tuple[Any, float, int]]) -> Array:
        """Return functions, their factors, and how many internal states each has, as `call_all` takes them."""
        found = np.zeros(1 + CALLED.size * len(functions))
        found.view(np.int64)[0] = len(functions)
        for row, (function, factor, states) in zip(found[1:].reshape(-1, CALLED.size), functions, strict=True):
            row[CALLED.factor] = factor
            pack(row.view(np.int64), CALLED, function=self._with_address(function).address, states=states)
        self.keepalive.append(found)
        return found

    def _lay_out(self, terms: Sequence[Term], slopes: Callable[[Term], Any] | None = None) -> None:
        """Write what `generalised` needs to know of terms; `slopes` are what gives the derivatives of functions."""
        found = np.zeros(1 + TERM.size * len(terms))
        whole = found.view(np.int64)
        whole[0] = len(terms)
        for k, term in enumerate(terms):
            place = 1 + TERM.size * k
            found[place : place + TERM.size] = numbers_of(term)
            if kernel_kind(term) in FUNCTIONS:
                whole[place + TERM.function] = self._with_address(term.c_function or evaluated(term)).address
                whole[place + TERM.slopes] = 0 if slopes is None else self._with_address(slopes(term)).address
        self.keepalive.append(found)
        self.generalised, self.terms = generalised.address, found.ctypes.data

    def _with_address(self, function: Any) -> Any:
        """Return what has the address of what is compiled, or of a callback of what runs in Python and may raise."""
        if isinstance(function, PythonFunction):
            called = function

            def guarded(t: float, first: Any, second: Any, found: Any) -> None:
                try:
                    numbers = called.function(t, first, second).tolist()
                except BaseException as error:  # it must not pass through the kernel
                    numbers = [np.nan] * called.size  # the next errors follow from these
                    if self.error is None or not isinstance(error, Exception):
                        self.error = error
                for k, x in enumerate(numbers):
                    found[k] = x

            function = Moment(guarded)
        self.keepalive.append(function)
        return function if hasattr(function, "address") else Callback(pointer_address(function))

    def _moment(self, t: float, directors: Any, angular_velocity: Any) -> Array:
        q, w = np.array(directors[:9]).reshape(3, 3), np.array(angular_velocity[:3])
        return state_moment_at(self.load, t, q, w)

    def reason(self, last: Array) -> str | Exception:
        """Return why the function has failed: what Python says at the state that it was called with `last`.

        That is 16 numbers: directors, angular velocity, moment, time.
        """
        if self.error is None:
            try:
                whole = Load(tuple(term for term in self._whole.terms if term not in self._whole.memories))
                whole.state_moment(float(last[15]), last[:9].reshape(3, 3), last[9:12])
                whole.potential_energy(last[:9].reshape(3, 3))
            except ValueError as error:
                self.error = error
        if isinstance(self.error, Exception):
            return self.error
        return f"the load is not finite at t = {last[15]:.12g} s; {REMEDY}{SMALLER}"

    def require_no_interrupt(self) -> None:
        """Raise what has interrupted a function in Python, Ctrl-C or `SystemExit`: it could not pass the kernel."""
        if self.error is not None and not isinstance(self.error, Exception):
            raise self.error


class DifferentiableFunctions(StateFunctions):
    """The terms of a load, with their derivatives."""

    def __init__(self, terms: Sequence[Term], action: int, has_time: bool) -> None:
        self.action, self.keepalive, self.error = action, [], None
        self.differenced, self._reported = set[str](), set[str]()  # names of functions of which differences were taken

        def slopes(term: Term) -> Any:
            if term.slopes is not None:
                return term.slopes
            known = dict[tuple[bytes, float], Array]()  # of the last states, which are asked for more than once

            def table(t: float, first: Any, second: Any) -> Array:
                x = np.array([*arguments(term, t, first, second), *term.numbers])
                speed = second[3] if term.counts[1] else 0.0
                if (key := (x.tobytes(), speed)) not in known:
                    if len(known) >= KEPT:
                        known.clear()
                    known[key], name = slopes_of(term, x, speed, has_time)
                    self.differenced |= {name} - {""}
                return known[key].ravel()

            given_to = sum(term.counts) + bool(term.counts[1]) + len(term.numbers)
            return PythonFunction(table, count_of(term) * (1 + given_to))

        self._lay_out(terms, slopes)

    def require_no_error(self) -> None:
        """Raise what a function in Python has raised: it could not pass the kernel; tell of differences, once."""
        error, self.error = self.error, None
        if error is not None:
            raise error
        if names := sorted(self.differenced - self._reported):
            self._reported |= self.differenced
            warn(differenced(names))


class Callback(NamedTuple):
    """A callback."""

    address: int


class PythonFunction(NamedTuple):
    """What a callback calls: a function of time, and of numbers in memory, and how many numbers it gives."""

    function: Callable[[float, Any, Any], Array]
    size: int


def arguments(term: Term, t: float, first: Any, second: Any) -> Array:
    """Return what a function in Python is called with: directors, velocity, time; γ of a potential."""
    n, m = term.counts
    return np.array([*first[:n], *second[:m], t] if m else first[:n])


def count_of(term: Term) -> int:
    """Return how many numbers a function gives: forces, a moment, or V and its gradient."""
    return 1 + term.counts[0] if isinstance(term, Potential) else prod(term.gives)


def evaluated(term: Term) -> PythonFunction:
    """Return the function of a term, without its factor, in Python: forces, a moment, or V and its gradient."""
    return PythonFunction(lambda t, first, second: value_of(term, arguments(term, t, first, second)), count_of(term))


def kernel_kind(term: Term) -> int:
    """Return what `generalised` takes a term for."""
    kinds = (GravityGradient, ORBITING), (Quadratic, QUADRATIC), (Spring, SPRING), (Potential, FUNCTION)
    otherwise = OF_FORCES if term.kind == "forces" else OF_MOMENT
    return next((kind for made, kind in kinds if isinstance(term, made)), otherwise)


def numbers_of(term: Term) -> Array:
    """Return a term as `generalised.Term` has it, without addresses."""
    found, kind = np.zeros(TERM.size), kernel_kind(term)
    found.view(np.int64)[TERM.kind], found[TERM.scale] = kind, term.scale
    if kind in FUNCTIONS:
        own = term.numbers
        found.view(np.int64)[TERM.numbers], found[TERM.own : TERM.own + len(own)] = len(own), own
    if not isinstance(term, Potential):
        return found
    vectors = term.vectors
    if isinstance(term, GravityGradient):
        found[TERM.stiffness], found[TERM.rest] = term.mean_motion, term.start
        found[TERM.square] = term.eccentricity
        vectors = np.array([term.radial, np.cross(term.normal, term.radial)])
    if isinstance(term, Quadratic):
        found[TERM.linear : TERM.quadratic] = term.linear
    if isinstance(term, Quadratic | GravityGradient):
        found[TERM.quadratic : TERM.square] = term.quadratic.ravel()
    if isinstance(term, Spring):
        found[TERM.linear : TERM.quadratic], found[TERM.square] = term.point, term.square
        found[TERM.stiffness], found[TERM.rest] = term.stiffness, term.rest_length
    found.view(np.int64)[TERM.dimension] = len(term.vectors)
    found[TERM.vectors : TERM.vectors + vectors.size] = vectors.ravel()
    return found


def changes_of_numbers(term: Term, name: str) -> Array:
    """Return what `numbers_of` a term whose text is called change by, along each number of a field."""
    before = term.varying[: term.varying.index(name)]
    first, along = TERM.own + sum(np.size(getattr(term, other)) for other in before), changes_of_field(term, name)
    found = np.zeros((len(along), TERM.size))
    found[:, first : first + along.shape[1]] = along
    return found
