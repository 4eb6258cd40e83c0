"""External moments: functions of time given along moving or fixed directions, and functions of the state.

The virtual work of an external moment is ``δW = δθ·m`` (remark under eq-standard); on directors it acts as
``f^i = 1/2 m × d_i``. A `Load` is a sum of terms, each of one kind:

- "body": components M(t) along the moving directors, ``m = Σ M_i d_i``;
- "space": components m(t) along fixed axes;
- "state": a function of time, directors and angular velocity that returns the spatial moment.

The first two depend on time alone, so a run evaluates them once, at the nodes that its integrator names, before it
starts; only terms of the third kind are called while it marches. Terms are zero outside their support, which is
half-open, ``start <= t < end``; breakpoints are the times where a term or its derivatives jump.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_number
from ..geometry.values import among, shown
from .terms import TERMS, Damping, Term, load_in_words

MOST = 4  # terms that a repr names


@dataclass(frozen=True, repr=False)
class Load:
    """A sum of external moments. Add loads, multiply them by numbers.

    Made by `body_moment`, `space_moment`, `moment`, `damping`, `pulse`, `sine`.

    Attributes
    ----------
    terms : tuple of Term
        What is added up, each term with its kind and its factor.

    Raises
    ------
    ValueError
        Something else than terms, or a term of a kind that `TERMS` lacks.

    Examples
    --------
    >>> from nontwist import damping, pulse
    >>> load = pulse((1, 0, 0)) - 0.5 * pulse((0, 2, 0), start=1, end=3) + damping(0.2)
    >>> load.breakpoints
    (0.0, 0.5, 1.0, 2.0, 3.0)
    >>> load.sample([0.5, 2.0], "body")
    array([[ 1.,  0.,  0.],
           [ 0., -1.,  0.]])

    Loads are values: equal where their terms are, and picklable, with functions as well.

    >>> 2 * damping(0.1)
    <Load: damping 0.2 N m s>
    >>> damping(0.1) == damping([0.1, 0.1, 0.1])
    True
    """

    terms: tuple[Term, ...] = field(default=())

    def __post_init__(self) -> None:
        if not isinstance(self.terms, tuple) or not all(isinstance(term, Term) for term in self.terms):
            raise ValueError(
                f"terms must be a tuple of Term, got {shown(self.terms)}; body_moment and others make loads"
            )
        if unknown := [type(term) for term in self.terms if not isinstance(term, tuple(TERMS.values()))]:
            raise ValueError(f"nontwist.loads.TERMS has no entry for the class {unknown[0].__name__}")

    def __repr__(self) -> str:
        more = len(self.terms) - MOST
        return f"<Load: {load_in_words([t.description for t in self.terms[:MOST]])}{f'; {more} more' * (more > 0)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        import cloudpickle  # a function that no module has, such as a closure, is pickled as it is

        return _unpickled, (cloudpickle.dumps(self.terms),)

    def __add__(self, other: Load) -> Load:
        return Load(self.terms + other.terms) if isinstance(other, Load) else NotImplemented

    def __mul__(self, factor: float) -> Load:
        c = float(as_array(factor, "factor of a load", ()))
        return Load(tuple(term.scaled(c) for term in self.terms))

    __rmul__ = __mul__

    def __neg__(self) -> Load:
        return -1.0 * self

    def __sub__(self, other: Load) -> Load:
        return self + -other

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which the load or a derivative of it jumps, sorted, s."""
        return tuple(sorted({t for term in self.terms for t in term.breakpoints}))

    @property
    def resolution(self) -> float:
        """The longest step that resolves the load, s (inf where nothing is known)."""
        return min((term.resolution for term in self.terms), default=np.inf)

    @property
    def end(self) -> float:
        """The time from which on the load is known to be zero, s; -inf without terms."""
        return max((term.zero_from for term in self.terms), default=-inf)

    @property
    def depends_on_state(self) -> bool:
        """Whether a term must be called with the state while a run marches."""
        return any(term.kind == "state" for term in self.terms)

    @property
    def damping(self) -> Array:
        """The sum of the damping matrices C, (3, 3), N m s."""
        matrices = (term.scale * term.damping for term in self.terms if isinstance(term, Damping))
        return sum(matrices, np.zeros((3, 3)))

    @property
    def called(self) -> Load:
        """The terms that must be called with the state while a run marches: all of kind "state" but damping."""
        return Load(tuple(term for term in self.terms if term.kind == "state" and not isinstance(term, Damping)))

    @property
    def is_compiled(self) -> bool:
        """Whether every term that must be called is compiled."""
        return all(term.compiled is not None for term in self.called.terms)

    @cached_property
    def description(self) -> list[dict[str, Any]]:
        """The terms as plain data; functions are named, not stored."""
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
            A function raised, gave NaN or a wrong shape; the time is in the message.
        """
        times = as_array(times, "times", (None,))
        if not among(kind, ("body", "space")):
            raise ValueError(f"kind must be 'body' or 'space', got {shown(kind)}")
        total = np.zeros((times.size, 3))
        for term in self.terms:
            if term.kind == kind:
                total += term.scale * term.samples(times)
        return total

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Sum all terms at one time and state: spatial moment, N m.

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
        """Sum the terms that depend on the state: spatial moment, N m.

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
            Arguments that are not finite or of another shape; a function raised, gave NaN or a wrong shape: the time is
            in the message.
        """
        q, w = as_array(directors, "directors", (3, 3)), as_array(angular_velocity, "angular_velocity", (3,))
        return state_moment_at(self, as_number(t, "t"), q, w)


def moment_at(load: Load, t: float, directors: Array, angular_velocity: Array) -> Array:
    """Return what `Load.moment` does, of arguments that are known to be sound."""
    total = state_moment_at(load, t, directors, angular_velocity)
    for term in load.terms:
        if term.kind != "state":
            m = term.scale * term.samples(np.array([t]))[0]
            total += m @ directors if term.kind == "body" else m
    return total


def state_moment_at(load: Load, t: float, directors: Array, angular_velocity: Array) -> Array:
    """Return what `Load.state_moment` does, of arguments that are known to be sound."""
    total = np.zeros(3)
    for term in load.terms:
        if term.kind == "state":
            total += term.scale * term.moment(t, directors, angular_velocity)
    return total


def as_load(value: Any) -> Load:
    """Return `value`, a load or None, as a load; a ValueError for anything else."""
    if value is None:
        return Load()
    if not isinstance(value, Load):
        raise ValueError(
            f"load must be a Load or None, got {shown(value)}; moment(function) makes one of a function of the state, "
            "body_moment(...) and space_moment(...) of a function of time or a table"
        )
    return value


def _unpickled(terms: bytes) -> Load:
    return Load(pickle.loads(terms))
