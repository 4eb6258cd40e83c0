"""External moments: functions of time given along moving or fixed directions, and functions of the state.

The virtual work of an external moment is ``δW = δθ·m`` (remark under eq-standard); on directors it acts as
``f^i = 1/2 m × d_i``. A `Load` is a sum of terms, each of one kind:

- "body": components M(t) along the moving directors, ``m = Σ M_i d_i``;
- "space": components m(t) along fixed axes;
- "state": a function of time, directors and angular velocity that returns the spatial moment;
- "forces": forces on the directors (`potentials`), of moment Σ d_i × f^i, from a table or a function of the state;
- "potential": a potential of space vectors seen from the body (`potentials`).

The first two depend on time alone, so a run evaluates them once, at the nodes that its integrator names, before it
starts; the others are evaluated while it marches, tables of forces at nodes sampled beforehand. Terms are zero outside
their support, which is half-open, ``start <= t < end``; breakpoints are the times where a term or its derivatives jump.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_floats, as_number
from ..geometry.values import require_among, short_repr
from ..kernels.vectors import Matrix, first_moment
from ..machine import cached_property
from .friction import DryFriction, Sliding, require_distinct_axes
from .kinds import LOADS, load_in_words
from .memory_terms import Driven, Memory, OnBodyAtRest, Wheel
from .potentials import SPACE_AND_BODY, ForceTable, GravityGradient, Potential
from .terms import Damping, ForceTerm, Momentum, Table, Term

MOST = 4  # terms that a repr names


@dataclass(frozen=True, repr=False)
class Load:
    """A sum of external moments. Loads can be added, and multiplied by numbers.

    Returned by `body_moment`, `space_moment`, `moment`, `rotor`, `director_forces`, `potential`, `spring` and others.

    Attributes
    ----------
    terms : tuple of Term
        The terms of the sum, each with its kind and its factor.

    Raises
    ------
    ValueError
        `terms` contains something that is not a term, or a term of an unknown kind.

    Examples
    --------
    >>> from nontwist import damping, pulse
    >>> load = pulse((1, 0, 0)) - 0.5 * pulse((0, 2, 0), start=1, end=3) + damping(0.2)
    >>> load.breakpoints
    (0.0, 0.5, 1.0, 2.0, 3.0)
    >>> load.sample([0.5, 2.0], "body")
    array([[ 1.,  0.,  0.],
           [ 0., -1.,  0.]])

    Loads are equal if their terms are, and can be pickled, also with functions.

    >>> 2 * damping(0.1)
    <Load: damping 0.2 N m s>
    >>> damping(0.1) == damping([0.1, 0.1, 0.1])
    True
    """

    terms: tuple[Term, ...] = field(default=())

    def __post_init__(self) -> None:
        if not isinstance(self.terms, tuple) or not all(isinstance(term, Term) for term in self.terms):
            raise ValueError(
                f"terms must be a tuple of Term, got {short_repr(self.terms)}; body_moment and others make loads"
            )
        known: tuple[type, ...] = (*LOADS.values(), Driven, OnBodyAtRest)
        if unknown := [type(one).__name__ for one in self.terms if not isinstance(one, known)]:
            raise ValueError(
                f"nontwist.loads.LOADS has no entry for the class {unknown[0]}: "
                f'add it below the class, as LOADS["{unknown[0].lower()}"] = {unknown[0]}'
            )
        require_distinct_axes(self.terms)

    def __repr__(self) -> str:
        more = len(self.terms) - MOST
        return f"<Load: {load_in_words([t.description for t in self.terms[:MOST]])}{f'; {more} more' * (more > 0)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        import cloudpickle  # a function that no module has, such as a closure, is pickled as it is

        return _unpickled, (cloudpickle.dumps(self.terms),)

    def __add__(self, other: Load | Term) -> Load:
        return Load(self.terms + as_load(other).terms) if isinstance(other, Load | Term) else NotImplemented

    def __radd__(self, other: float) -> Load:
        return self if isinstance(other, int) and other == 0 else NotImplemented  # what `sum` begins with

    def __mul__(self, factor: float) -> Load:
        c = float(as_array(factor, "factor of a load", ()))
        return Load(tuple(term.scaled(c) for term in self.terms))

    __rmul__ = __mul__

    def __truediv__(self, divisor: float) -> Load:
        if (c := float(as_array(divisor, "divisor of a load", ()))) == 0:
            raise ValueError("divisor of a load must not be 0; 0 * load has no moment")
        return self * (1.0 / c)

    def __neg__(self) -> Load:
        return -1.0 * self

    def __sub__(self, other: Load | Term) -> Load:
        return self + -other

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which the load or one of its derivatives jumps, sorted, s."""
        return tuple(sorted({t for term in self.terms for t in term.breakpoints}))

    @property
    def resolution(self) -> float:
        """The longest step that resolves the load, s; inf if unknown."""
        return min((term.resolution for term in self.terms), default=np.inf)

    @cached_property
    def support(self) -> Array:
        """Disjoint intervals outside which the load is known to be zero, sorted, (k, 2), s."""
        each = np.concatenate([np.empty((0, 2)), *(term.support for term in self.terms)])
        each = each[np.argsort(each[:, 0])]
        reached = np.maximum.accumulate(each[:, 1])
        is_disjoint = each[1:, 0] > reached[:-1]
        begins, ends = (np.append(*pair)[: len(each)] for pair in (([True], is_disjoint), (is_disjoint, [True])))
        return np.stack([each[begins, 0], reached[ends]], axis=1)

    @property
    def end(self) -> float:
        """The time from which on the load is known to be zero, s; -inf without terms."""
        return float(self.support[-1, 1]) if len(self.support) else -inf

    @property
    def depends_on_state(self) -> bool:
        """Whether a term depends on the state and is evaluated during the integration."""
        return any(term.kind not in ("body", "space") for term in self.terms)

    @property
    def is_linear(self) -> bool:
        """Whether all that depends on time is linear between breakpoints."""
        return all(term.is_linear for term in self.terms if not isinstance(term, Damping))

    @property
    def damping(self) -> Array:
        """The sum of the damping matrices C, (3, 3), N m s."""
        matrices = (term.scale * term.damping for term in self.terms if isinstance(term, Damping))
        return sum(matrices, np.zeros((3, 3)))

    @cached_property
    def called(self) -> Load:
        """The terms called with the state during the integration: of kind "state", and not known to the kernels."""
        return Load(tuple(term for term in self.terms if term.kind == "state" and not term.in_kernels))

    @cached_property
    def frictions(self) -> tuple[DryFriction, ...]:
        """The terms that are dry friction."""
        return tuple(term for term in self.terms if isinstance(term, DryFriction))

    @property
    def without_frictions(self) -> Load:
        """The load without its dry friction."""
        return Load(tuple(term for term in self.terms if not isinstance(term, DryFriction)))

    @cached_property
    def rotors(self) -> tuple[Momentum, ...]:
        """The terms that are rotors or wheels."""
        return tuple(term for term in self.terms if isinstance(term, Momentum))

    @property
    def drives(self) -> bool:
        """Whether dry friction, or motors of wheels whose momenta are known beforehand, do work."""
        return any(isinstance(one, Sliding) or (isinstance(one, Driven) and one.of.works) for one in self.terms)

    @cached_property
    def wheels(self) -> tuple[Wheel, ...]:
        """The terms that are wheels."""
        return tuple(term for term in self.terms if isinstance(term, Wheel))

    @cached_property
    def is_dry(self) -> bool:
        """Whether friction jumps with the state, of the body or of a wheel, so that runs are taken apart."""
        return bool(self.frictions) or any(one.is_dry for one in self.wheels)

    def rotor_momentum(self, times: ArrayLike) -> Array:
        """Return the momentum of the rotors relative to the body, in body components: the sum of h a over all rotors.

        Parameters
        ----------
        times : (n,) array, s

        Returns
        -------
        (n, 3) array, kg m² s⁻¹

        Raises
        ------
        ValueError
            Times are not finite, or have another shape.
        """
        at = as_array(times, "times", (None,))
        return sum((term.scale * term.momentum(at) for term in self.rotors), np.zeros((at.size, 3)))

    def rotor_torque(self, times: ArrayLike) -> Array:
        """Return the rate of that momentum at (n,) times, (n, 3), N m.

        Raises
        ------
        ValueError
            As `rotor_momentum`.
        """
        at = as_array(times, "times", (None,))
        found = (term.scale * term.history(at)[1][:, None] * term.direction for term in self.rotors)
        return sum(found, np.zeros((at.size, 3)))

    @cached_property
    def is_compiled(self) -> bool:
        """Whether all functions called during the integration are compiled."""
        return not self.in_python

    @cached_property
    def in_python(self) -> tuple[Term, ...]:
        """The terms whose functions are called during the integration and are not compiled."""
        return tuple(x for x in (*self.called.terms, *self.functions, *self.memories) if x.c_function is None)

    @cached_property
    def is_immutable(self) -> bool:
        """Whether it calls no function in Python, which may return other numbers another time."""
        return self.is_compiled and all(one.columns or one.kind not in ("body", "space") for one in self.terms)

    @cached_property
    def is_series(self) -> bool:
        """Whether equations with it can be run on series: nothing that acts is a function of the state."""
        return all(
            term.kind in ("body", "space")
            or isinstance(term, Damping | Momentum)
            or (isinstance(term, Wheel) and term.is_driven)
            or (isinstance(term, Potential) and term.dead_force is not None)
            for term in map(_table_as_moment, self.terms)
        )

    @cached_property
    def functions(self) -> tuple[Term, ...]:
        """The terms of director forces and potentials that are functions."""
        return tuple(term for term in self.terms if isinstance(term, ForceTerm) and not term.in_kernels)

    @cached_property
    def memories(self) -> tuple[Memory, ...]:
        """The terms with memory, wheels first; wheels of which it is known beforehand are none."""
        return tuple(term for term in self.remembering if not (isinstance(term, Wheel) and term.is_driven))

    @cached_property
    def remembering(self) -> tuple[Memory, ...]:
        """The terms with internal states: wheels, then others."""
        return (
            *self.wheels,
            *(term for term in self.terms if isinstance(term, Memory) and not isinstance(term, Wheel)),
        )

    @property
    def internal_state(self) -> Array:
        """The internal states z of the terms with memory at the start of a run, one behind the other, (k,)."""
        return np.concatenate([np.zeros(0), *(term.state0 for term in self.remembering)])

    @property
    def placed(self) -> Iterator[tuple[Memory, slice]]:
        """The terms with internal states, wheels as without a factor, and the places of these."""
        place = 0
        for term in self.remembering:
            count = term.state0.size
            yield term.unscaled if isinstance(term, Wheel) else term, slice(place, place + count)
            place += count

    @property
    def internal_scale(self) -> Array:
        """How large they become, (k,)."""
        return np.concatenate([np.zeros(0), *(term.state_scale for term in self.remembering)])

    @cached_property
    def potentials(self) -> tuple[Potential, ...]:
        """The terms that are potentials."""
        return tuple(term for term in self.terms if isinstance(term, Potential))

    @property
    def without_potentials(self) -> Load:
        """The load without its potentials."""
        return Load(tuple(term for term in self.terms if not isinstance(term, Potential)))

    def potential_energy(self, directors: ArrayLike, times: ArrayLike = 0.0) -> Array:
        """Return the energy of the potentials.

        Parameters
        ----------
        directors : (..., 3, 3) array
            Rows d_i.
        times : (...) array, s
            Required for potentials that depend on time.

        Returns
        -------
        (...) array, J

        Raises
        ------
        ValueError
            An argument has the wrong shape, or a function raised or returned something that is not a finite number.
        """
        q = as_floats(directors, "directors")
        if q.shape[-2:] != (3, 3):
            raise ValueError(f"directors must have the shape (..., 3, 3), got {q.shape}")
        t = as_floats(times, "times")
        energies = (term.energy(q, t) for term in self.potentials)
        return sum(energies, np.zeros(q.shape[:-2]))

    @cached_property
    def description(self) -> list[dict[str, Any]]:
        """The terms as plain data; of functions only the names are stored."""
        return [term.description for term in self.terms]

    def sample(self, times: ArrayLike, kind: Literal["body", "space"]) -> Array:
        """Evaluate the terms of one kind that depend on time alone.

        Parameters
        ----------
        times : (n,) array, s
        kind : "body" or "space"

        Returns
        -------
        (n, 3) array, N m

        Raises
        ------
        ValueError
            A function raised, or returned NaN or a wrong shape; the message states the time.
        """
        times = as_array(times, "times", (None,))
        require_among(kind, "kind", ("body", "space"))
        total = np.zeros((times.size, 3))
        for term in self.terms:
            if term.kind == kind:
                total += term.scale * term.samples(times)
        return total

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the sum of all terms at one time and state: spatial moment, N m.

        Parameters
        ----------
        t : float, s
        directors : (3, 3) array
            Rows d_i.
        angular_velocity : (3,) array, rad/s
            In space.

        Returns
        -------
        (3,) array, N m

        Raises
        ------
        ValueError
            As `state_moment`.
        """
        at, q = as_number(t, "t"), as_array(directors, "directors", (3, 3))
        w = as_array(angular_velocity, "angular_velocity", (3,)) if self.depends_on_state else np.zeros(3)
        return moment_at(self, at, q, w)

    def state_moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return the sum of the terms that depend on the state, including potentials: spatial moment, N m.

        Parameters
        ----------
        t, directors, angular_velocity
            As in `moment`.

        Returns
        -------
        (3,) array, N m

        Raises
        ------
        ValueError
            An argument is not finite or has another shape; or a function raised, or returned NaN or a wrong shape: the
            message states the time.
        """
        q, w = as_array(directors, "directors", (3, 3)), as_array(angular_velocity, "angular_velocity", (3,))
        return state_moment_at(self, as_number(t, "t"), q, w)


def is_called(term: Term) -> bool:
    """Whether a term depends on the state, and is nothing that kernels know: damping, a rotor, a dead force."""
    if term.kind in ("body", "space") or isinstance(term, Damping | Momentum | Wheel):
        return False
    return not isinstance(term, Potential) or term.dead_force is None


def tables_as_moments(load: Load) -> Load:
    """Return a load with the moments of forces that are tables along the directors in the place of these."""
    return Load(tuple(_table_as_moment(term) for term in load.terms))


def forces_sampled(load: Load, times: Array) -> Array:
    """Return the tables of director forces at (n,) times, (n, 18): rows in space, then along the directors."""
    total = np.zeros((times.size, SPACE_AND_BODY))
    for term in load.terms:
        if isinstance(term, ForceTable):
            part = slice(0, 9) if term.frame == "space" else slice(9, 18)
            total[:, part] += term.scale * term.samples(times)
    return total


def of_body(load: Load, inertia: Array) -> Load:
    """Return the load of a body with this inertia, which the gravity gradient needs to know."""
    if not any(isinstance(term, GravityGradient) for term in load.terms):
        return load
    return Load(tuple(term.of_body(inertia) if isinstance(term, GravityGradient) else term for term in load.terms))


def with_torques(load: Load, torques: Array) -> Load:
    """Return a load with a torque beside that of each wheel, (w,), N m, which no factor multiplies."""
    each = iter(torques.tolist())
    return Load(tuple(one.with_torque(next(each)) if isinstance(one, Wheel) else one for one in load.terms))


def _table_as_moment(term: Term) -> Term:
    """Return a table of forces along the directors as the moment that it is, other terms as they are."""
    if not (isinstance(term, ForceTable) and term.frame == "body"):
        return term
    moments = np.stack(first_moment(Matrix(*np.moveaxis(term.forces_of, 0, -1))), axis=1)
    return Table("body", term.times, moments, scale=term.scale)


def moment_at(load: Load, t: float, directors: Array, angular_velocity: Array) -> Array:
    """Return what `Load.moment` does, of arguments that are known to be sound."""
    total = state_moment_at(load, t, directors, angular_velocity)
    for term in load.terms:
        if term.kind in ("body", "space"):
            m = term.scale * term.samples(np.array([t]))[0]
            total += m @ directors if term.kind == "body" else m
    return total


def state_moment_at(load: Load, t: float, directors: Array, angular_velocity: Array) -> Array:
    """Return what `Load.state_moment` does, of arguments that are known to be sound."""
    terms = (one for one in load.terms if one.kind not in ("body", "space"))
    return sum((one.scale * one.moment_at(t, directors, angular_velocity) for one in terms), np.zeros(3))


def forces_at(load: Load, t: float, directors: Array, angular_velocity: Array) -> Array:
    """Return the forces on the directors of a load of director forces and potentials, rows of (3, 3)."""
    terms = (one for one in load.terms if isinstance(one, ForceTerm))
    return sum((one.scale * one.forces_at(t, directors, angular_velocity) for one in terms), np.zeros((3, 3)))


NOTHING = Load()


def as_load(value: Any) -> Load:
    """Return `value`, a load or None, as a load; a ValueError for anything else."""
    if value is None:
        return NOTHING
    if isinstance(value, Term):
        return value.load
    if isinstance(value, (list, tuple)) and value and all(isinstance(one, Load | Term) for one in value):
        raise ValueError("load must be one Load: add the loads of the list with +, as in load=a + b")
    if not isinstance(value, Load):
        raise ValueError(
            f"load must be a Load or None, got {short_repr(value)}; moment(function) makes one of a function of the "
            "state, body_moment(...) and space_moment(...) of a function of time or a table"
        )
    return value


def _unpickled(terms: bytes) -> Load:
    return Load(pickle.loads(terms))
