"""What a march samples of a load beforehand, and what it makes of a load before it does.

In a step a prescribed spin W3 goes along the chord between c at both ends, a polynomial of a degree not above the
number of stages, so W3 = c at every node, whatever the grid is: of a table whose kinks are nodes it is c itself, and
the order is that of the scheme.

**Rotors.** Within a step the momentum c of the rotors is taken as the polynomial whose rate has, at the nodes θ_j of
the step, the values of c' there, but for a constant by which it is c at both ends,

    c'_j = c'(t_j) + r,    Σ b_j c'_j = (c_{n+1} - c_n)/h,    c_j = c_n + h Σ a_jk c'_k.

So it is collocated as the unknowns of the step are. In a step of one node, and for rotors, whose c is linear between
the times of a table, c' is the chord. The impulses of the steps add up to c at every node, whatever the grid is, and
with them the schemes keep the total momentum π + Λc exactly: with the mean momentum Q of the step `lie_midpoint` has
``ΔP + Δc = h (Q + c_m) × Ω``, the free step of the total momentum, and `gauss` a bilinear function Λ (P + c). A rotor
of constant momentum is drag with a skew matrix, ``c × W``, and does no work; as it spins up its work is ``-h c'·W``, W
of the step.

**Steps in which no moment acts** (`Unloaded`): a scheme that is exact without load covers each segment of them at once.
In such a segment the march carries the state in which the segment began; the states that are stored in it are evaluated
from there, and so is the state at its end. So what a segment gives does not depend on where the march pauses.

**Wheels** (`loads.memory_terms`). Every scheme integrates bodies with wheels as gyrostats, where h is known beforehand.
A problem with wheels becomes that of what carries them, of inertia J_c, with rotors of momentum h, or loads with memory
h. Its constraints and their multipliers are the same. What is said of its intervals becomes again what is said of the
body with its wheels locked, of momentum J W = J_c W + z, z = Σ I (n·W) n, and energy ½ W·J W = ½ W·J_c W + ½ W·z: the
mean moment of the load has beside that on the carrier the change of Λz, its work that of ½ W·z.

The work of a motor whose torque is known beforehand, ``A = ∫ τ Ω dt = Δh²/2I - n·∫ τ W dt``, follows from the integrals
of W and of t W over the stages of each step, and has its order. The energy of the whole changes by these works and by
those of other loads, to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import NDArray

from ..engine.body_frames import body_rows, hinged_of
from ..engine.generalised import EXACT, STAGE
from ..engine.records import BODY, FORCES, Parts
from ..geometry.arrays import Array, dot
from ..geometry.attitudes import States, attitudes
from ..kernels.kernel import address_of
from ..loads import Load
from ..loads.load import forces_sampled, tables_as_moments
from ..loads.memory_terms import Driven, Wheel
from ..loads.potentials import ForceTable, GravityGradient
from ..loads.terms import Damping
from ..models.stack import SystemStack, is_principal, stacked
from ..models.system import DirectorSystem, euler_inertia
from .compiled import Compiled
from .ivp import IVP, Outcome

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
    systems: SystemStack, load: Load, unit: float, scale: Array, scheme: Compiled, **known: Any
) -> tuple[Array, list[Parts], NDArray[np.int64]]:
    """Return rows of bodies as they are marched, what there is in their marches, and in which one each body is."""
    bodies = body_rows(systems, load, unit, scale, scheme.is_exact_without_load)
    if scheme.dissipation:
        bodies[:, BODY.dissipation + scheme.order - 1] = scheme.dissipation
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
    return bodies, groups, np.array([groups.index(parts) for parts in marched])[np.searchsorted(found, flags)]


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
    rest = Load(tuple(term for term in load.terms if term not in linear))
    if (hinged := hinged_of(systems)) is not None:
        return stacked(replace(hinged, dead_force=dead[0])), rest
    m = len(dead)
    E, own = np.broadcast_to(systems.euler_inertia, (m, 3, 3)), (systems.axis, systems.spin_factor)
    axis, factor = (x if x is None else np.broadcast_to(x, (m, *x.shape[1:])) for x in own)
    return replace(systems, euler_inertia=E, axis=axis, dead_force=dead, spin_factor=factor), rest


def orbit_of(systems: SystemStack, load: Load, unit: float, scheme: Compiled) -> Array | None:
    """Return rate, in radians in a unit of time, and axis of the orbit that `gauss` sees the rows from, else None.

    That is where the gravity gradient of a circular orbit acts alone: all else is given in a frame that stands still,
    and an ellipse turns at no constant rate.
    """
    term = load.terms[0] if len(load.terms) == 1 and scheme.needs.action == STAGE else None
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
    driven = Load(tuple(one for one in load.rotors if isinstance(one, Driven)))
    if len(middles) > 1 and driven.terms:
        times = begin[:, None] + middles * length[:, None]
        found += beside_chord(driven.rotor_torque(times.ravel()).reshape(found[:, :, 3:].shape), length, middles)
    found[:, :, :3] /= unit
    return found.reshape(-1, 6)


def beside_chord(rate: Array, length: Array, middles: Array) -> Array:
    """Return what is left of a momentum and its rate at the nodes of steps, (n, s, 6), beside its chord."""
    A, b = coefficients(tuple(middles.tolist()))
    rate = rate - np.einsum("j,njc->nc", b, rate)[:, None]
    return np.concatenate([length[:, None, None] * np.einsum("ij,njc->nic", A, rate), rate], axis=2)


def lagrange_integrals(nodes: Array, ends: Array) -> Any:
    """Return the integrals of the Lagrange polynomials of some nodes from 0 to each of the ends, (..., nodes)."""
    x, y, k = 2 * nodes - 1, 2 * ends - 1, np.arange(1, len(nodes))
    P = legvander(y, len(nodes))
    of_legendre = np.concatenate([y[..., None] + 1, (P[..., 2:] - P[..., :-2]) / (2 * k + 1)], axis=-1) / 2
    found = np.linalg.solve(legvander(x, len(nodes) - 1).T, of_legendre.reshape(-1, len(nodes)).T)
    return found.T.reshape(of_legendre.shape)


@lru_cache
def coefficients(middles: tuple[float, ...]) -> tuple[Array, Array]:
    """Return A, b of the collocation at some nodes: integrals of its polynomials up to each node, and to the end."""
    found = lagrange_integrals(np.array(middles), np.array([*middles, 1.0]))
    return found[:-1], found[-1]


class Unloaded:
    """Segments of equal steps in which a load is known to be zero, in a grid.

    Attributes
    ----------
    begin : (k,) int array, number of the first step of each
    end : (k,) int array, number of the step that follows the last one
    """

    def __init__(self, problem: IVP, load: Load | None) -> None:
        """Find the segments; without a load, of a scheme that is not exact, there are none."""
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

    def segment_of(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of the segment that each step is in, -1 where it is in none."""
        j = np.searchsorted(self.begin, steps, side="right") - 1
        return np.where(j == np.searchsorted(self.end, steps, side="right"), j, -1)

    def before(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many of the steps before each are in a segment."""
        if not len(self):
            return np.zeros_like(steps)
        j = np.searchsorted(self.begin, steps, side="right")
        last = np.maximum(j - 1, 0)
        return np.where(j > 0, self._passed[last] + np.minimum(steps, self.end[last]) - self.begin[last], 0)


COMMANDED = 4  # internal states of a wheel that takes a torque beside its own
NO_FACTOR = 1e-150  # in the place of a factor of 0, which nothing can be divided by
X, WEIGHTS = (leggauss(8)[0] + 1) / 2, leggauss(8)[1] / 2


def first_internal_states(systems: SystemStack, load: Load, time: float, velocity: Array, scale: Array) -> Array:
    """Return the internal states at the start of runs that continue none, (m, k), given W, (m, 3)."""
    found, W = np.tile(load.internal_state, (len(velocity), 1)), with_spin(systems, velocity, time)
    for wheel, column in wheel_columns(load):
        found[:, column] = wheel.inertia * (scale * wheel.scale * wheel.speed + dot(W, wheel.direction))
    return found


def with_spin(systems: SystemStack, velocity: Array, time: float) -> Array:
    """Return W, (m, 3), with the prescribed spin about constrained axes, of the velocity across them."""
    return velocity if systems.axis is None else velocity + systems.spin_at(time)[:, None] * systems.axis


def wheel_columns(load: Load) -> Iterator[tuple[Wheel, int]]:
    """Yield each wheel, and the column of its h among the internal states."""
    column = 0
    for wheel in load.wheels:
        yield wheel, column
        column += wheel.state0.size


def driven_columns(load: Load) -> list[int]:
    """Return the columns of the wheels of which h is known beforehand."""
    return [column + k for wheel, column in wheel_columns(load) if wheel.is_driven for k in range(wheel.state0.size)]


def carrier(system: DirectorSystem, load: Load) -> DirectorSystem:
    """Return what carries the wheels of a body; a ValueError where nothing is left of it."""
    J = system.convected_inertia - sum(one.locked for one in load.wheels)
    if (least := np.linalg.eigvalsh(J)[0]) <= 0:
        raise ValueError(
            "the inertia of a body includes that of its wheels, locked: without it, J - Σ I n nᵀ, the least principal "
            f"moment is {least:.6g} kg m², and must be positive; add the wheels to the inertia, or make them lighter"
        )
    found = replace(system, euler_inertia=euler_inertia(J, physical=False), physical=False, spin=None)
    if system.spin is None:
        return found
    if not is_principal(stacked(found)).all():
        raise ValueError(
            "spin= needs an axis that is principal without the wheels as well, of J - Σ I n nᵀ: put wheels along it "
            "or across it, or add one that balances it"
        )
    return replace(found, spin=system.spin)


def commanded(load: Load) -> Load:
    """Return a load whose wheels take torques beside their own: the last of `COMMANDED` internal states."""
    return Load(
        tuple(replace(one.unscaled, is_commanded=True) if isinstance(one, Wheel) else one for one in load.terms)
    )


def as_gyrostat(problem: IVP) -> IVP:
    """Return a problem of one body, with wheels, as that of their carrier."""
    one = problem.member(0)
    assert one.internal is not None
    z, t, columns = one.internal[0], one.t_start, iter(wheel_columns(one.load))

    def term_of(wheel: Wheel) -> Driven | Wheel:
        _, column = next(columns)
        own = wheel.unscaled
        if not wheel.is_driven:
            return own
        return Driven(own, t, float(z[column]), breakpoints=own.breakpoints, resolution=own.resolution)

    load = Load(tuple(term_of(term) if isinstance(term, Wheel) else term for term in one.load.terms))
    internal = np.delete(one.internal, driven_columns(one.load), axis=1) if load.memories else None
    return replace(one, systems=stacked(carrier(one.system, one.load)), load=load, internal=internal)


def as_scaled_gyrostat(problem: IVP) -> IVP:
    """Return the same with the factor beside the load, as in the problem, but for momenta of wheels, which have it."""
    one, factor = as_gyrostat(problem), problem.load_scale.item() or NO_FACTOR
    pairs = zip(one.load.terms, problem.load.terms, strict=True)
    terms = tuple(replace(new, scale=1 / factor) if isinstance(old, Wheel) else old for new, old in pairs)
    return replace(one, load=Load(terms), load_scale=np.array([factor]))


def with_wheels(problem: IVP, states: States, times: Array) -> States:
    """Return the states of `as_gyrostat` at times, with all internal states of the problem but works."""
    assert problem.internal is not None
    at, driven, first = np.append(problem.t_start, times), driven_columns(problem.load), problem.internal
    shape = states.velocity.shape[:-1]  # of one body, or of several
    internal = np.full((*shape, first.shape[1]), np.nan)
    if states.internal is not None:
        internal[..., np.delete(np.arange(first.shape[1]), driven)] = states.internal
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven:
            change = wheel.scale * (wheel.impulse(at)[1:] - wheel.impulse(at)[0])
            momenta = first[:, column, None] + problem.load_scale[:, None] * change
            internal[..., column] = momenta if len(shape) > 1 else momenta[0]
    return states._replace(internal=internal)


def of_locked(problem: IVP, outcome: Outcome) -> Outcome:
    """Return the outcome of `as_gyrostat` as that of the body with its wheels, locked."""
    times = outcome.times(problem)
    outcome = outcome._replace(states=with_wheels(problem, outcome.states, times))
    if outcome.intervals is None:
        return outcome
    if outcome.intervals.velocity_integrals is not None:
        _set_works(problem, outcome.states.internal, outcome.intervals.velocity_integrals, times)
    p, W, locked = outcome.states.quaternion, outcome.states.velocity, sum(one.locked for one in problem.load.wheels)
    z, intervals, length = W @ locked, outcome.intervals, np.diff(times)
    with np.errstate(all="ignore"):  # states behind a failure are undefined
        moment = np.diff(np.einsum("mkij,mkj->mki", attitudes(p), z), axis=1) / length[:, None]
    work = np.diff((W * z).sum(axis=-1), axis=1) / 2
    return outcome._replace(
        intervals=intervals._replace(moment=intervals.moment + moment, load_work=intervals.load_work + work)
    )


# ---- the work of motors whose torques are known beforehand


def with_works(problem: IVP) -> IVP:
    """Return a problem with the outputs of which works are made: also the start, and kinks of torques."""
    kinks = {t for one in problem.load.wheels if one.is_driven for t in one.breakpoints}
    if not any(one.is_driven and one.works for one in problem.load.wheels):
        return problem
    inner = [t for t in kinks if problem.t_start < t < problem.stored_times[-1]]
    times = np.union1d(problem.stored_times, [problem.t_start, *inner])
    output_times = problem.output_times if len(times) == len(problem.stored_times) else times
    return replace(problem, intervals=True, output_times=output_times)


def _set_works(problem: IVP, z: Array | None, velocity_integrals: Array, times: Array) -> None:
    """Put the works of driven wheels to the states."""
    first = problem.internal
    assert z is not None
    assert first is not None
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven and wheel.works:
            factor, h = wheel.scale * problem.load_scale[:, None], z[..., column]
            slope, impulse = factor * wheel.slope_of_torque(times), factor * np.diff(wheel.impulse(times))
            along = dot(velocity_integrals.reshape(*velocity_integrals.shape[:2], 2, 3), wheel.direction)
            works = work_of(wheel.inertia, times, h, slope, impulse, along[..., 0], along[..., 1])
            z[..., column + 1] = first[:, column + 1, None] + np.cumsum(np.insert(works, 0, 0.0, axis=1), axis=1)


def work_of(
    inertia: Any, times: Array, h: Array, slope: Array, impulse: Array, along: Array, velocity_moment: Array
) -> Array:
    """Return the work of a motor, ``∫ τ Ω dt = Δh²/2I - ∫ τ n·W dt``, τ linear between n + 1 times, (..., n).

    `h` are the momenta, (..., n + 1), `slope` is that of τ, `impulse` ∫ τ dt; `along` is ∫ n·W dt, `velocity_moment`
    ∫ t n·W dt.
    """
    torque = impulse / np.diff(times) - slope * (times[1:] + times[:-1]) / 2
    return np.diff(h) * (h[..., 1:] + h[..., :-1]) / (2 * inertia) - torque * along - slope * velocity_moment


def set_works_between(problem: IVP, states: States, nodes: States, velocities: Callable[[Array], Array]) -> None:
    """Put the works of driven wheels to the states at the times asked for, given those at all nodes of the grid.

    They are quadratures of τ Ω since the node before; `velocities` gives W at increasing times.
    """
    times, grid = problem.stored_times, problem.times(np.arange(problem.steps + 1))
    number = np.searchsorted(grid, times, side="right") - 1
    since = times - grid[number]
    at, place = np.unique(grid[number, None] + since[:, None] * X, return_inverse=True)
    W, first = velocities(at), problem.internal
    assert states.internal is not None
    assert nodes.internal is not None
    assert first is not None
    for wheel, column in wheel_columns(problem.load):
        if wheel.is_driven and wheel.works:
            change = wheel.impulse(at) - wheel.impulse(np.array([problem.t_start]))
            speed = (first[0, column] + wheel.scale * change) / wheel.inertia - W @ wheel.direction
            power = (wheel.scale * wheel.torque_at(at) * speed)[place].reshape(len(times), -1)
            states.internal[:, column + 1] = nodes.internal[number, column + 1] + since * (power @ WEIGHTS)
