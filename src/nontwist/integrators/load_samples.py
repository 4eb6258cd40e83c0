"""What a march samples of a load beforehand, and what it makes of a load before it does.

In a step a prescribed spin W3 goes along the chord between c at both ends, a polynomial of a degree not above the
number of stages, so W3 = c at every node, whatever the grid is: of a table whose kinks are nodes it is c itself, and
the order is that of the scheme.

Rotors. Within a step the momentum c of the rotors is taken as the polynomial whose rate has, at the nodes θ_j of the
step, the values of c' there, but for a constant by which it is c at both ends,

    c'_j = c'(t_j) + r,    Σ b_j c'_j = (c_{n+1} - c_n)/h,    c_j = c_n + h Σ a_jk c'_k.

So it is collocated as the unknowns of the step are. In a step of one node, and for rotors, whose c is linear between
the times of a table, c' is the chord. The impulses of the steps add up to c at every node, whatever the grid is, and
with them the schemes keep the total momentum π + Λc exactly: with the mean momentum Q of the step `lie_midpoint` has
``ΔP + Δc = h (Q + c_m) × Ω``, the free step of the total momentum, and `gauss` a bilinear function Λ (P + c). A rotor
of constant momentum is drag with a skew matrix, ``c × W``, and does no work; as it spins up its work is ``-h c'·W``, W
of the step.

Steps in which no moment acts (`Unloaded`): a scheme that is exact without load covers each stretch of them at once. In
such a stretch the march carries the state in which the stretch began; the states that are stored in it are evaluated
from there, and so is the state at its end. So what a stretch gives does not depend on where the march pauses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from ..engine.generalised import EXACT
from ..engine.records import BODY, FORCES, Parts
from ..geometry.arrays import Array
from ..kernels.kernel import address_of
from ..loads import Load
from ..loads.base import forces_sampled, tables_as_moments
from ..loads.forces import ForceTable
from ..loads.potentials import GravityGradient
from ..loads.terms import Damping
from ..loads.wheels import Driven
from ..models.stack import SystemStack
from .compiled import Compiled
from .problem import IVP

Ends = tuple[Array, Array, Array]

WIDTHS = {"times": 1, "moving": 3, "space": 3, "forces": FORCES, "rotor": 6, "spin": 1}  # numbers of a node
BYTES = 8 * np.array(list(WIDTHS.values()))
Samples = tuple[Array | None, ...]
NOTHING: Samples = (None,) * len(WIDTHS)


def sampled(
    systems: SystemStack, load: Load, unit: float, times: Callable[[], Array], steps: Callable[[], Ends], middles: Array
) -> Samples:
    """Return what acts at nodes: times, moments along the frame and in space, forces, rotors, spin; None: none.

    Parameters
    ----------
    systems, load : as they are marched
    unit : of time
    times : called where a load acts: the times of the nodes, step by step
    steps : called where something acts along the chord of a step: where steps begin and end, and their lengths
    middles : the nodes of a step, as fractions
    """
    found: dict[str, Array | None] = dict.fromkeys(WIDTHS)
    if load.terms:
        kinds, at = {term.kind for term in load.terms}, times()
        found["times"] = at
        found["moving"] = load.sample(at, "body") if "body" in kinds else None
        found["space"] = load.sample(at, "space") if "space" in kinds else None
        found["forces"] = forces_sampled(load, at) if has_table(load) else None
    if load.rotors or systems.spin is not None:
        begin, end, length = steps()
        if systems.spin is not None and not systems.spin.is_constant:  # its changes in the steps
            change = (systems.spin.at(end) - systems.spin.at(begin)) * unit
            found["spin"] = np.repeat(change, len(middles))
        found["rotor"] = at_nodes(load, begin, end, length, middles, unit) if load.rotors else None
    return tuple(found.values()) if load.terms or found["spin"] is not None else NOTHING


def has_table(load: Load) -> bool:
    """Whether a load has tables of forces on the directors."""
    return any(isinstance(term, ForceTable) for term in load.terms)


def march_parts(
    systems: SystemStack, load: Load, bodies: Array, scheme: Compiled, **known: Any
) -> tuple[list[Parts], NDArray[np.int64]]:
    """Return what there is in marches of bodies under a load, as they are marched, and in which one each body is."""
    kinds, spin = {term.kind for term in load.terms}, systems.spin
    shared = Parts(
        is_director_scheme=scheme.is_director_scheme,
        is_constrained=systems.axis is not None,
        dissipates=bool(scheme.dissipation),
        moving="body" in kinds,
        space="space" in kinds,
        damping=any(isinstance(term, Damping) for term in load.terms),  # also of a factor 0: members have the same bits
        rotor=bool(load.rotors),
        spin=spin is not None and not spin.is_constant,
        forces=has_table(load),
        is_exact=scheme.needs.action == EXACT,
    )._replace(**known)
    columns = slice(BODY.dead, BODY.damping), slice(BODY.off, BODY.free), slice(BODY.vertical, BODY.dissipation)
    is_dead, is_nonprincipal, has_vertical = (bodies[:, own].any(axis=1) for own in columns)
    flags = is_dead + 2 * (is_nonprincipal | (spin is not None)) + 4 * has_vertical
    found = np.flatnonzero(np.bincount(flags))

    def parts_with(flags: int) -> Parts:
        parts = shared._replace(dead=bool(flags & 1))
        return parts._replace(motion=scheme.motion(parts, bool(flags & 2), bool(flags & 4)))

    marched = [parts_with(one) for one in found.tolist()]
    groups = list(dict.fromkeys(marched))
    return groups, np.array([groups.index(parts) for parts in marched])[np.searchsorted(found, flags)]


def addresses(samples: Samples, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where the samples at nodes of these numbers lie, (nodes, kinds); 0: there are none."""
    first = np.array([address_of(array) for array in samples])
    return np.where(first > 0, first + BYTES * nodes[:, None], 0)


def as_marched(problem: IVP, is_director_scheme: bool) -> tuple[SystemStack, Load]:
    """Return bodies and load as a march takes them: linear potentials as dead forces, tables of forces as moments.

    Forces that are tables along the directors stay forces in a director scheme, whose multipliers know them.
    """
    load, systems = problem.load, problem.systems
    if not is_director_scheme:
        load = tables_as_moments(load)
    linear = [term for term in load.potentials if term.dead_force is not None]
    if not linear:
        return systems, load
    force = np.zeros((3, 3))
    for term in linear:
        force += term.scale * np.asarray(term.dead_force)
    dead = systems.dead_force + problem.load_scale[:, None, None] * force
    m = len(dead)
    axis = None if systems.axis is None else np.broadcast_to(systems.axis, (m, 3))
    E = np.broadcast_to(systems.euler_inertia, (m, 3, 3))
    rest = Load(tuple(term for term in load.terms if term not in linear))
    return replace(systems, euler_inertia=E, axis=axis, dead_force=dead), rest


def orbit_of(systems: SystemStack, load: Load, unit: float) -> Array | None:
    """Return rate, in radians in a unit of time, and axis of the orbit that `gauss` sees the rows from, else None.

    That is where the gravity gradient of a circular orbit acts alone: all else is given in a frame that stands still,
    and an ellipse turns at no constant rate.
    """
    term = load.terms[0] if len(load.terms) == 1 else None
    if not isinstance(term, GravityGradient) or term.eccentricity or systems.has_dead_force:
        return None
    return np.array([term.mean_motion * unit, *term.normal])


def at_nodes(load: Load, begin: Array, end: Array, length: Array, middles: Array, unit: float) -> Array:
    """Return the momentum of the rotors over the unit of time, and its rate, at the nodes of some steps, (nodes, 6).

    `begin`, `end` and `length` are those of the steps, `middles` the nodes of one, as fractions.
    """
    first = load.rotor_momentum(begin)
    change = load.rotor_momentum(end) - first
    found = np.empty((len(begin), len(middles), 6))
    found[:, :, :3] = first[:, None] + middles[:, None] * change[:, None]
    found[:, :, 3:] = (change / length[:, None])[:, None]
    if len(middles) > 1 and any(isinstance(one, Driven) for one in load.rotors):
        times = begin[:, None] + middles * length[:, None]
        found += beside_chord(load.rotor_torque(times.ravel()).reshape(found[:, :, 3:].shape), length, middles)
    found[:, :, :3] /= unit
    return found.reshape(-1, 6)


def beside_chord(rate: Array, length: Array, middles: Array) -> Array:
    """Return what is left of a momentum and its rate at the nodes of steps, (n, s, 6), beside its chord."""
    A, b = coefficients(tuple(middles.tolist()))
    rate = rate - np.einsum("j,njc->nc", b, rate)[:, None]
    return np.concatenate([length[:, None, None] * np.einsum("ij,njc->nic", A, rate), rate], axis=2)


@lru_cache
def coefficients(middles: tuple[float, ...]) -> tuple[Array, Array]:
    """Return A, b of the collocation at some nodes: integrals of its polynomials up to each node, and to the end."""
    x, s = 2 * np.array([*middles, 1.0]) - 1, len(middles)
    P, k = legvander(x, s), np.arange(1, s)
    integrals = np.column_stack([x + 1, (P[:, 2:] - P[:, :-2]) / (2 * k + 1)]) / 2
    found: Any = np.linalg.solve(P[:-1, :s].T, integrals.T).T
    return found[:-1], found[-1]


class Unloaded:
    """Stretches of equal steps in which a load is known to be zero, in a grid.

    Attributes
    ----------
    begin : (k,) int array, number of the first step of each
    end : (k,) int array, number of the step that follows the last one
    """

    def __init__(self, problem: IVP, load: Load | None) -> None:
        """Find the stretches; without a load, of a scheme that is not exact, there are none."""
        self.begin: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.end = self.begin
        if load is not None:
            begin = problem.steps_until(np.concatenate([[-np.inf], load.support[:, 1]]))
            end = problem.steps_ended(np.concatenate([load.support[:, 0], [np.inf]]))
            begin, end, numbers = begin[end > begin], end[end > begin], np.array(problem.grid.numbers[1:-1])
            is_inside = np.searchsorted(begin, numbers) > np.searchsorted(end, numbers, side="right")
            self.begin, self.end = np.union1d(begin, numbers[is_inside]), np.union1d(end, numbers[is_inside])
        self._passed = np.concatenate([[0], np.cumsum(self.end - self.begin)])

    def __len__(self) -> int:
        return len(self.begin)

    def stretch_of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of the stretch that each step is in, -1 where it is in none."""
        j = np.searchsorted(self.begin, steps, side="right") - 1
        return np.where(j == np.searchsorted(self.end, steps, side="right"), j, -1)

    def before(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of the steps before each are in a stretch."""
        if not len(self):
            return np.zeros_like(steps)
        j = np.searchsorted(self.begin, steps, side="right")
        last = np.maximum(j - 1, 0)
        return np.where(j > 0, self._passed[last] + np.minimum(steps, self.end[last]) - self.begin[last], 0)
