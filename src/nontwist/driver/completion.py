"""The check of every run, every member of an ensemble, and so of every block of a sweep; and why an iteration stalls.

Status 0 means: t_end reached, times increasing, every number finite, including those of the dataset that follow from
the states, and every quaternion of unit length. A run that fails the check is a failed run; its valid states are kept.

Loads that jump with the state, other than dry friction. Where what a function of the state returns jumps on the way of
a step, its equations may have no solution, at any length: on either side of the jump the load pushes the body to the
other. A stall is looked into once: from the beginning of the step, W and internal states change at their rates there,
and moments, and rates of internal states, are followed over two steps. The interval of the largest change is halved
again and again: the change of a smooth function becomes small with it, and a jump stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from ..analysis.variables import NODES, Acting, observables
from ..geometry.arrays import Array
from ..geometry.attitudes import States, attitudes, directors
from ..geometry.values import number_text, vector_text
from ..integrators.integrator import BEYOND_JUMPS, IVP, Failure, Integrator, Outcome, Status
from ..integrators.ivp import FIRST, LEAST, MOST, OBSERVED, onward
from ..integrators.load_samples import as_gyrostat, as_marched, of_locked, set_works_between, with_wheels, with_works
from ..integrators.marched_stacks import Marched
from ..integrators.stepping import one_by_one
from ..loads.load import state_moment_at
from ..loads.memory_terms import Memory, Wheel, gain_of_energy
from ..loads.terms import Term
from .grid import require_resolution

if TYPE_CHECKING:
    from .contacts import Contacts

TANGENT = 1e-15  # of the velocity: below it director velocities are tangent
LENGTH = 1e-3  # how far Σ |q|² may be from the number of quaternions q
SAFE = 1e300  # sum of squares of all numbers, times the inertia, up to which no observable overflows
OVERFLOW = (
    "the variable {} is not finite at the end of it; choose units of time, length and mass in which the numbers of the "
    "run are nearer to 1"
)
NO_ROTATION = "its quaternion is not of unit length, which is a defect of the integrator; use another integrator"
MISSING_STATES = "the integrator returned {} of {} states, which is a defect of it; use another integrator"
NOT_INCREASING = "the output times do not increase up to t_end"
X, WEIGHTS = (leggauss(4)[0] + 1) / 2, leggauss(4)[1] / 2  # between two nodes
COLUMN_NAMES = np.repeat(list(OBSERVED), list(OBSERVED.values()))
BETWEEN = "kinetic_energy", "potential_energy", "spatial_momentum", "material_momentum", "twist_rate"
AT_ONCE, INSIDE_NS = 2**18, 15_000  # states; of a step of a member, as measured
ROUND_OFF = 1e-12  # of the largest value: what an extremum is off by


def checked_march(scheme: Integrator, problem: IVP, threads: int = 1) -> Outcome:
    """Integrate `problem` and check the outcome, which depends on the arguments alone.

    Members that fail the check are marked as failed; after the valid states of a member its numbers are NaN.

    Raises
    ------
    ValueError
        As the integrator; the steps are below the resolution of the times.
    KeyboardInterrupt
        In a stack of more than one.
    """
    require_resolution(problem.t_start, problem.t_end, problem.grid)
    load = problem.load
    in_kernels = not (load.is_dry or load.wheels or any(one.dead_force is None for one in load.potentials))
    own = problem if in_kernels else replace(problem, observed=False)
    if load.is_dry:
        from . import rubbing  # which marches the parts of a run by this function

        outcome = rubbing.march_with_friction(scheme, own, threads)
    else:
        outcome = unchecked(scheme, own, threads)
    if in_kernels and problem.output_times is None and isinstance(done := outcome.march, Marched):
        largest = max(1.0, abs(problem.systems.euler_inertia).max())
        if largest * done.squares < SAFE and increases(done.march.march.stack):
            return outcome
    if problem.observed and outcome.observed is None:
        outcome = outcome._replace(
            observed=np.stack([_observed(scheme, problem.member(i)) for i in range(len(problem))])
        )
    elif outcome.observed is not None and (V := sum(one.scale * one.constant for one in load.potentials)):
        over = np.reshape([1.0, 1.0, 1.0, problem.t_end - problem.t_start], (4, 1))  # first, least, most, integral
        outcome.observed[:, :, COLUMN_NAMES == "potential_energy"] += problem.load_scale[:, None, None] * V * over
    reasons = dict(outcome.reasons)
    for i in np.flatnonzero(outcome.failures[:, 0] == Status.STALLED).tolist():
        last = int(outcome.good[i]) - 1
        known = None if problem.output_times is not None else (int(problem.stored[last]), outcome.states.part(i, last))
        if (failure := named_jump(scheme, problem.member(i), outcome.failure(i), known)) is not None:
            outcome.failures[i], reasons[i] = failure[:4], failure.reason
    for i, good, failure in _failed_members(problem, outcome):
        outcome.good[i] = good
        if outcome.failures[i, 0] == Status.OK:
            outcome.failures[i], reasons[i] = failure[:4], failure.reason
        if outcome.observed is not None:
            outcome.observed[i] = np.nan
    for i in np.flatnonzero(outcome.good < outcome.states.quaternion.shape[1]).tolist():
        for array in outcome.states:
            if array is not None:
                array[i, outcome.good[i] :] = np.nan
    return outcome._replace(reasons=reasons)


def unchecked(scheme: Integrator, problem: IVP, threads: int = 1) -> Outcome:
    """Integrate a problem, one with wheels as that of gyrostats, member by member."""
    if not problem.load.wheels:
        return scheme.march(problem, threads)
    whole, are_alike = with_works(problem), problem.wheel_torque is None  # then of all at once, which is quicker

    def march_one(one: IVP) -> Outcome:
        found = scheme.march(as_gyrostat(one))
        return found if are_alike else of_locked(one, found)

    found = one_by_one(march_one, whole, threads)
    found = of_locked(whole, found) if are_alike else found
    if len(whole.stored_times) == len(problem.stored_times):
        return found if problem.intervals else found._replace(intervals=None)
    return found.at(whole, problem)


def _observed(scheme: Integrator, problem: IVP) -> Array:
    """Return what is observed of one body, (4, COLUMNS), where no kernel does: at nodes, for integrals between them."""
    nodes = problem.times(np.arange(problem.steps + 1))
    h = np.diff(nodes)
    times = np.append(np.column_stack([nodes[:-1], nodes[:-1, None] + h[:, None] * X]).ravel(), nodes[-1])
    whole = replace(problem, output_times=times, intervals=True, observed=False, progress=None)
    outcome = checked_march(scheme, whole)
    if outcome.failure() is not None:
        return np.full((4, len(COLUMN_NAMES)), np.nan)
    means, systems = outcome.intervals, problem.systems
    assert means is not None
    names = [name for name in OBSERVED if name in NODES]
    found = observables(names, systems, outcome.states, Acting.of(problem.load, times))
    work = np.append(0.0, np.cumsum(means.load_work[0]))
    found["energy"] = found["kinetic_energy"] + found["potential_energy"] - work
    found["vertical_momentum"] = found["spatial_momentum"] @ as_marched(problem, False)[0].vertical[0]
    mu = means.multipliers[0, :, -1:] if systems.axis is not None else np.zeros((len(times) - 1, 1))
    reaction = -np.add.reduceat(mu * np.diff(times)[:, None], np.arange(0, len(mu), 1 + len(X)))[:, 0] / h
    found["reaction_moment"] = np.zeros(len(times))[None]
    columns = np.column_stack([found[name][0] for name in OBSERVED])
    ends, inner = columns[:: 1 + len(X)], columns[:-1].reshape(len(h), 1 + len(X), -1)[:, 1:]
    integral = np.einsum("n,k,nkc->c", h, WEIGHTS, inner)
    if means.twist is not None:  # to the end of a slip within a step as well
        integral[COLUMN_NAMES == "twist_rate"] = means.twist.sum()
    result = np.array([ends[0], ends.min(axis=0), ends.max(axis=0), integral])
    result[:, -1] = np.nan, reaction.min(), reaction.max(), reaction @ h
    return result


def with_extrema(scheme: Integrator, problem: IVP, outcome: Outcome, threads: int = 1) -> Outcome:
    """Return an outcome whose extrema are those of the motion between nodes as well, where states have series there."""
    from ..analysis.statistics import KNOTS, highest  # which a run does not need

    if outcome.observed is None or not scheme.has_series(problem.systems, problem.load):
        return outcome
    nodes, observed = problem.times(np.arange(problem.steps + 1)), outcome.observed.copy()
    inside = nodes[:-1, None] + np.diff(nodes)[:, None] * ((1 + KNOTS[:-1]) / 2)
    times = np.append(inside.ravel(), nodes[-1])
    size = max(1, AT_ONCE // len(times))
    for first in range(0, len(problem), size):
        last = min(first + size, len(problem))
        part = replace(problem.part(first, last), output_times=times, intervals=False, observed=False)
        acting = Acting.of(part.load, times, part.load_scale)
        found = unchecked(scheme, part, threads)
        is_done = found.good == len(times)
        for array in found.states[:2]:
            array[~is_done] = np.nan
        for name, y in observables(BETWEEN, part.systems, found.states, acting).items():
            for row, sign in ((MOST, 1.0), (LEAST, -1.0)):
                own = observed[first:last, row, name == COLUMN_NAMES].T
                for known, values in zip(own, np.moveaxis(np.atleast_3d(y), 2, 0), strict=True):
                    before, after = known[is_done], sign * highest(sign * values[is_done])
                    is_more = sign * (after - before) > ROUND_OFF * abs(values[is_done]).max(axis=1)
                    known[is_done] = np.where(is_more, after, before)
                observed[first:last, row, name == COLUMN_NAMES] = own.T
    return outcome._replace(observed=observed)


def extrema_seconds(scheme: Integrator, problem: IVP, members: int) -> float:
    """Return about how long `with_extrema` takes for members like `problem`, s."""
    return members * problem.steps * INSIDE_NS * 1e-9 * scheme.has_series(problem.systems, problem.load)


def between(scheme: Integrator, problem: IVP, states: States) -> States | None:
    """Return the states of one body at the times asked for, as `Integrator.between`."""
    if not problem.load.wheels:
        return scheme.between(problem, states)
    one = as_gyrostat(problem)
    if (found := scheme.between(one, states)) is None:
        return None
    whole = with_wheels(problem, found, problem.stored_times)

    def velocities(times: Array) -> Array:
        between = scheme.between(replace(one, output_times=times), states)
        assert between is not None
        return between.velocity

    if any(wheel.is_driven and wheel.works for wheel in problem.load.wheels):
        set_works_between(problem, whole, states, velocities)
    return whole


def increases(problem: IVP) -> bool:
    """Whether times of states increase, up to the end of the problem where the outputs are not others."""
    times = problem.stored_times
    at_end = problem.output_times is not None or times[-1] == problem.t_end
    return bool(at_end and (times[1:] > times[:-1]).all())


def _failed_members(problem: IVP, outcome: Outcome) -> Iterator[tuple[int, int, Failure]]:
    """Yield members with numbers that are not finite or missing states, their valid states, and the failure."""
    done, expected = outcome.failures[:, 0] == Status.OK, len(problem.stored_times)
    if not increases(problem):
        failure = problem.failed(1, Status.INCOMPLETE, NOT_INCREASING)
        yield from ((i, 1, failure) for i in np.flatnonzero(done).tolist())
        return
    for i in np.flatnonzero(done & (outcome.good != expected)).tolist():
        found = int(outcome.good[i])
        yield i, found, problem.failed(found, Status.INCOMPLETE, MISSING_STATES.format(found, expected))
    for i in np.flatnonzero(~_is_safe(problem, outcome)).tolist():
        if ends := list(_ends_of_member(problem, outcome, i)):
            good, reason = min(ends, key=itemgetter(0))
            yield i, good, problem.failed(good, Status.NOT_FINITE, reason)
        elif done[i] and outcome.observed is not None and not (fine := _finite_columns(outcome)[i]).all():
            name = str(COLUMN_NAMES[fine.argmin()])
            yield i, 1, problem.failed(1, Status.NOT_FINITE, OVERFLOW.format(name))
    yield from _driven_members(problem, outcome)


def _driven_members(problem: IVP, outcome: Outcome) -> Iterator[tuple[int, int, Failure]]:
    """Yield members as `_failed_members` in which friction, a function, gives energy to a wheel."""
    rubbing = [(a, wheel.friction) for a, wheel in enumerate(problem.load.wheels) if wheel.friction is not None]
    if not rubbing:
        return
    acting = Acting.of(problem.load, problem.stored_times)
    found = observables(("wheel_speed", "wheel_loss"), problem.systems, outcome.states, acting)
    for a, friction in rubbing:
        speed, loss = found["wheel_speed"][..., a], found["wheel_loss"][..., a]
        for i, n in enumerate(outcome.good.tolist()):
            for k in np.flatnonzero(np.diff(loss[i, :n]) < 0).tolist():
                if reason := gain_of_energy(friction, np.linspace(speed[i, k], speed[i, k + 1], GLANCES)):
                    yield i, k + 1, problem.failed(k + 1, Status.LOAD, reason)
                    break


def _is_safe(problem: IVP, outcome: Outcome) -> NDArray[np.bool_]:
    """Whether nothing of a member can overflow, and its quaternions are of unit length, (m,)."""
    m, k = outcome.states.quaternion.shape[:2]
    E = np.maximum(abs(problem.systems.euler_inertia).max(axis=(1, 2)), 1.0)
    arrays = [array for array in (*outcome.states, *(outcome.intervals or ())[:3]) if array is not None]
    with np.errstate(all="ignore"):
        squares = [np.einsum("ij,ij->i", rows, rows) for rows in (array.reshape(m, -1) for array in arrays)]
        safe: NDArray[np.bool_] = (E * sum(squares) < SAFE) & (abs(squares[0] - k) < LENGTH)
    return safe if outcome.observed is None else np.logical_and(safe, _finite_columns(outcome).all(axis=1))


def _finite_columns(outcome: Outcome) -> NDArray[np.bool_]:
    """Whether what was observed is finite, (m, COLUMNS); a reaction moment has no first value."""
    assert outcome.observed is not None
    finite = np.isfinite(outcome.observed)
    finite[:, FIRST, -1] = True
    return np.asarray(finite.all(axis=1), dtype=np.bool_)


def _ends_of_member(problem: IVP, outcome: Outcome, i: int) -> Iterator[tuple[int, str]]:
    """Yield how many states come before the first that is not valid, and what is wrong with it, for each variable."""
    n = int(outcome.good[i])
    own = outcome.states.part(slice(i, i + 1), slice(n))
    with np.errstate(all="ignore"):
        long = abs(np.square(own.quaternion[0]).sum(axis=1) - 1) >= LENGTH
    if long.any():
        yield int(long.argmax()), NO_ROTATION
    yield from _ends({"quaternion": own.quaternion[0], "material_angular_velocity": own.velocity[0]})
    with np.errstate(all="ignore"):
        one = problem.member(i)
        found = observables(NODES, one.systems, own, Acting.of(one.load, one.stored_times[:n]))
    yield from _ends({name: array[0] for name, array in found.items()})
    if outcome.intervals is not None:
        names = ("multipliers", "moment", "load_work")
        columns = {name: getattr(outcome.intervals, name)[i, : max(n - 1, 0)] for name in names}
        yield from ((good + 1, reason) for good, reason in _ends(columns))


def _ends(arrays: dict[str, Array]) -> Iterator[tuple[int, str]]:
    """Yield how many rows come before the first that is not finite, and the reason, of arrays with such a row."""
    for name, array in arrays.items():
        finite = np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
        if not finite.all():
            yield int(finite.argmin()), OVERFLOW.format(name)


GLANCES, HALVINGS = 64, 40
BENT, ONE_SIDED = 4, 0.7  # nodes that are looked at; part of a change that lies on one side of a jump
GLANCED = 100_000  # states of all members
LEFT = 0.4  # of the change between two of the times: what a jump leaves of it, half of it beside a sign of exactly 0
WAYS = (
    "the load {} jumps with the state, at about t = {} s {}, so that a step there may have no solution at any length; "
    + BEYOND_JUMPS
)
BESIDE = 1e-6  # of the span: so far from a jump are values that are told, as a sign of exactly 0 is 0
RATES = "in z' "  # of internal states
Value = Callable[[float, Array, Array, Array], Array]  # of time, directors as rows, W, and internal states


def named_jump(
    scheme: Integrator, problem: IVP, failure: Failure | None, known: tuple[int, States] | None = None
) -> Failure | None:
    """Return where the load of one body jumps, if that is why an iteration has stalled; `known`: a node, its state."""
    from .contacts import Contacts

    values = list(_values(problem))
    if failure is None or not values or problem.load.is_dry:  # of which parts were looked into
        return None
    at = Contacts(scheme, problem)
    t, (first, state) = float(problem.times(failure.step)), known or (0, None)
    if first < failure.step:
        before = unchecked(scheme, onward(problem, first, failure.step, state))
        if before.failure() is not None:
            return None
        state = before.states.part(0, -1)
    p, W, *_, z = state or at.state
    z = np.zeros(0) if z is None else z
    try:
        path = _path(at, t, p, W, z)
    except ValueError:
        return None
    for term, value, unit in values:
        found = _jump(lambda s, value=value: value(t + s, *path(s)), 2 * problem.step_at(failure.step))  # type: ignore[misc]
        if found is not None:
            s, x, y = found
            name, friction = _name(term, not unit), "coulomb=" if isinstance(term, Wheel) else "dry_friction"
            what = f"{'' if unit else RATES}from {vector_text(x)} to {vector_text(y)} {unit}".rstrip()
            text = WAYS.format(name, number_text(t + s, ".6g"), what, friction)
            return failure._replace(status=Status.JUMP, reason=text)
    return None


def misses_jump(scheme: Integrator, problem: IVP, outcome: Outcome, goal: float) -> bool:
    """Whether a load jumps so near a node that no stage has seen it, by which runs are off by more than `goal`.

    Between the last stage of a step and the first of the next one a jump acts as if it were at the node, on all grids
    that have the node. Looked at are those where W bends most, with the chords of the motion on both sides; where not
    all are stored, those of a run of its own, unless these are more than `GLANCED`.
    """
    if problem.load.is_dry or next(_values(problem.member(0)), None) is None:
        return False
    if len(problem.stored) <= problem.steps and len(problem) * problem.steps <= GLANCED:
        problem = replace(problem, stored=np.arange(problem.steps + 1), observed=False, progress=None)
        outcome = unchecked(scheme, problem)
    single = np.diff(problem.stored) == 1
    nodes = 1 + np.flatnonzero(single[1:] & single[:-1])
    bends = abs(np.diff(outcome.states.velocity, 2, axis=1)).max(axis=2)[:, nodes - 1]
    bends[outcome.failures[:, 0] != Status.OK] = 0.0
    for i, j in zip(*np.unravel_index(np.argsort(-bends, axis=None)[:BENT], bends.shape), strict=True):
        if bends[i, j] > 0 and any(miss > goal for miss in _missed(problem.member(int(i)), outcome, int(i), nodes[j])):
            return True
    return False


def _missed(problem: IVP, outcome: Outcome, i: int, k: int) -> Iterator[float]:
    """Yield by how much a member misses the jumps of its load about a node, of W relative to its size, or of z."""
    from scipy.spatial.transform import Rotation

    times, states = problem.stored_times, outcome.states
    t, p, W = times[k], states.quaternion[i, k], states.velocity[i, k - 1 : k + 2]
    z = np.zeros((3, 0)) if states.internal is None else states.internal[i, k - 1 : k + 2]
    longest = float(min(times[k] - times[k - 1], times[k + 1] - times[k]))

    def state(s: float) -> tuple[float, Array, Array, Array]:
        a, h = (0, t - times[k - 1]) if s < 0 else (1, times[k + 1] - t)
        rate, turned = (W[a + 1] - W[a]) / h, s * W[1] + s * s / 2 * (W[a + 1] - W[a]) / h
        attitude = attitudes(p) @ Rotation.from_rotvec(turned).as_matrix()
        return t + s, attitude.T, W[1] + s * rate, z[1] + s * (z[a + 1] - z[a]) / h

    speed = np.sqrt(np.nanmax(np.square(states.velocity[i]).sum(axis=1)))
    size = np.linalg.eigvalsh(problem.systems.convected_inertia[0])[0] * max(speed, 1 / (times[-1] - times[0]))
    for term, value, unit in _values(problem):
        parts = [value(*state(share * longest)) for share in (-0.5, 0.0, 0.5)]
        steps = abs(np.diff(parts, axis=0)).max(axis=1)
        if not steps.max() > ONE_SIDED * steps.sum() > 0:
            continue
        found = _jump(lambda s, value=value: value(*state(s - longest / 2)), longest)  # type: ignore[misc]
        if found is not None:
            s, x, y = found
            scale = size if unit else term.state_scale  # type: ignore[attr-defined]
            yield float((abs(y - x) * abs(s - longest / 2) / scale).max())


def _values(problem: IVP) -> Iterator[tuple[Term, Value, str]]:
    """Yield what functions of the state return that may jump: of which term, what, and the unit."""
    load = problem.load
    for term in load.terms:
        if term.kind in ("state", "forces") and not term.in_kernels:
            yield term, lambda t, q, W, z, term=term: state_moment_at(term.load, t, q, W @ q), "N m"  # type: ignore[misc]
    for term, place in load.placed:
        if not isinstance(term, Wheel):
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[0], "N m"
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[1], ""
        elif not term.is_driven:
            yield term, lambda *at, own=(term, place): _answers(*own, *at)[1][:1], "N m"  # torque less friction


def _answers(term: Memory, place: slice, t: float, q: Array, W: Array, z: Array) -> tuple[Array, Array]:
    return term.answers(t, q, W, z[place])


def _path(at: Contacts, t: float, p: Array, W: Array, z: Array) -> Callable[[float], tuple[Array, Array, Array]]:
    """Return the function that gives directors, W and z at a time after t, at the rates there."""
    from scipy.spatial.transform import Rotation

    q = directors(p)
    K, rates = at.forces(t, q, W, z.copy() if z.size else None)
    turning = at.Q @ K

    def state(s: float) -> tuple[Array, Array, Array]:
        turned = attitudes(p) @ Rotation.from_rotvec(s * W + s * s / 2 * turning).as_matrix()
        if not np.isfinite(turned).all():
            raise ValueError("the attitude is not finite")
        return turned.T, W + s * turning, z + s * rates

    return state


def _jump(value: Callable[[float], Array], span: float) -> tuple[float, Array, Array] | None:
    """Return where a function jumps in a span, and its values there; None where it does not, or fails."""
    try:
        times = np.linspace(0.0, span, GLANCES + 1)
        values = np.array([value(s) for s in times.tolist()])
        k = int(np.argmax(abs(np.diff(values, axis=0)).max(axis=1)))
        (a, b), (x, y) = times[k : k + 2].tolist(), values[k : k + 2]
        whole = abs(y - x).max()
        for _ in range(HALVINGS):
            m = value(c := (a + b) / 2)
            a, b, x, y = (c, b, m, y) if abs(y - m).max() >= abs(m - x).max() else (a, c, x, m)
        is_function = np.array_equal(value(a), x) and np.array_equal(value(b), y)  # no random number, for one
        ends = value(a - BESIDE * span), value(b + BESIDE * span)
    except ValueError:
        return None
    return (a, *ends) if is_function and abs(y - x).max() > LEFT * whole > 0 else None


def _name(term: Term, is_rate: bool) -> str:
    """Return the name of the function of a term that jumps."""
    called = term.memory if is_rate else term.called  # type: ignore[attr-defined]
    if getattr(called, "__self__", None) is term:
        return type(term).__name__.lower() if isinstance(term, Wheel) else type(term).__name__
    return str(getattr(called, "__name__", "of a C function"))
