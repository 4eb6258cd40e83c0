"""The estimated cost of a march: steps or subintervals, seconds on one core, bytes.

The times are orders of magnitude, measured on a slow core, without compilation; an integrator declares those of its own
steps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..engine.body_frames import bases_of, frames
from ..geometry.arrays import Array
from ..geometry.attitudes import directors
from ..loads import Load
from ..loads.load import forces_sampled, state_moment_at
from ..loads.memory_terms import Memory
from ..loads.terms import Function, Sine
from ..models.stack import SystemStack
from .ivp import IVP

ONE, ZERO = np.ones(1), np.zeros(3)
VARIES = 1.1  # the range of V over that of the attitudes that are tried
MOMENTA = 2000  # times at which those of rotors are sampled
DIFFERENCES, UNEQUAL = (2.0**-10, 2.0**-12), 0.1  # differences, of the size of numbers; by how much slopes differ
GONE = 7.0  # -log of what is left of a mode that has decayed
# A term of a load at a node, by its kind, and its memory; a function of time in Python; a substep with another one.
TERM_NS = {"body": 60, "space": 60, "state": 200, "forces": 200, "potential": 1_000, "memory": 200}
MEMORY_NS, CALL_NS, PYTHON_NS = 800, 10_000, 200_000
TIMED, ENOUGH = 10, 0.1  # calls that are timed at most, and s after which two must do
DRY_NS = 100_000  # a substep, for each dry friction


class Cost(NamedTuple):
    """The estimated cost of a march."""

    parts: int
    unit: str  #: what the parts are: steps, subintervals of a load, states
    seconds: float  #: on one core
    size: int  #: bytes in addition to the stored states


def steps_cost(problem: IVP, steps: int, substeps: int, substep_ns: float) -> Cost:
    """Return the cost of steps that take `substep_ns` nanoseconds a substep without their load."""
    load, ns = problem.load, substep_ns
    if not load.is_compiled:
        ns = max(ns, PYTHON_NS)
    if load.is_dry:  # slides and rests are told apart in Python
        ns = max(ns, DRY_NS * (len(load.frictions) + sum(one.is_dry for one in load.wheels)))
    ns += MEMORY_NS * len(load.memories)
    called = [isinstance(term, Function) and term.kind in ("body", "space") for term in load.terms]
    ns += sum(CALL_NS if is_called else TERM_NS[term.kind] for term, is_called in zip(load.terms, called, strict=True))
    return Cost(steps, "steps", steps * substeps * ns * 1e-9, 0)


def seconds_of_call(load: Load, problem: IVP) -> float:
    """Return how long a load takes that runs in Python; 0 where it fails, as a run says why.

    The least of some calls: the first may be slower, and on a busy machine any may have to wait.
    """
    start = problem.t_start, directors(problem.quaternion[0]), problem.velocity[0]
    times = [perf_counter()]
    try:
        while len(times) < 3 or (len(times) <= TIMED and times[-1] - times[0] < ENOUGH):
            state_moment_at(load, *start)
            times.append(perf_counter())
    except Exception:
        return 0.0
    return float(np.diff(times).min())


def damping_rate(systems: SystemStack, load: Load, scale: Array = ONE) -> float:
    """Return the largest rate at which damping slows a member or a wheel down, 1/s, or a bound of it.

    Of the body alone an eigenvalue of J⁻¹ C, across an axis; of wheels with viscous friction b of (1/I + n·J_c⁻¹n) b.
    """
    C, J, axis = load.damping, systems.convected_inertia, systems.axis
    rubbed = [one for one in load.wheels if one.viscous]
    if not (C.any() or rubbed):
        return 0.0
    of_wheels = np.zeros(len(J))
    if rubbed:
        n = np.array([one.direction for one in rubbed])
        J = J - sum(one.locked for one in load.wheels)
        S = n @ np.linalg.solve(J, np.broadcast_to(n.T, (len(J), 3, len(n)))) + np.diag(
            [1 / one.inertia for one in rubbed]
        )
        of_wheels = abs(np.linalg.eigvals(S * [one.viscous for one in rubbed])).max(axis=1)
    if axis is not None:
        plane = bases_of(axis)[:, :, :2]
        C, J = plane.mT @ C @ plane, plane.mT @ J @ plane
    rates = abs(np.linalg.eigvals(np.linalg.solve(J, np.broadcast_to(C, J.shape)))).max(axis=1)
    return float((abs(scale) * rates + of_wheels).max())


def damping_at(load: Load, t: float, directors: Array, W: Array, slowest: float) -> Array:
    """Return the matrix (3, 3), N m s, by which functions of the state damp a body as ``damping`` does; 0 if unknown.

    It is the symmetric part of -∂M/∂W without what drives. `slowest`: a rate of a body at rest, rad/s.
    """
    size = np.full(3, max(float(np.linalg.norm(W)), slowest))
    slopes = _derivatives_at(lambda V: directors @ state_moment_at(load, t, directors, V @ directors), W, size)
    values, axes = np.linalg.eigh(-(slopes + slopes.T) / 2)
    return axes * np.maximum(values, 0.0) @ axes.T


def memory_rate(load: Load, t: float, directors: Array, W: Array, z: Array) -> float:
    """Return the largest rate at which internal states of loads with memory, z, decay, 1/s; 0 if unknown."""
    fastest = 0.0
    for term, place in load.placed:

        def rates(own: Array, term: Memory = term) -> Array:
            return term.answers(t, directors, W, own)[1]

        slopes = _derivatives_at(rates, z[place], np.maximum(abs(z[place]), term.state_scale))
        fastest = max(fastest, -np.linalg.eigvals(slopes).real.min())
    return fastest


def _derivatives_at(function: Callable[[Array], Array], x: Array, size: Array) -> Array:
    """Return the derivatives of a function at x, rows, by differences; 0 where it fails, or jumps or bends nearby."""
    try:
        with np.errstate(all="ignore"):
            coarse, fine = (
                np.array([(function(x + d) - function(x - d)) / (2 * d.sum()) for d in np.diag(relative * size)])
                for relative in DIFFERENCES
            )
    except Exception:  # a run says what is wrong with a function
        return np.zeros((x.size, x.size))
    is_smooth = abs(coarse - fine).max() <= UNEQUAL * abs(fine).max()  # also not where a number is none
    return fine if is_smooth else np.zeros((x.size, x.size))


def unresolved(problem: IVP, order: int, is_a_stable: bool) -> str | None:
    """Return what to say of damped modes in steps of h > order/λ, which do not resolve a decay at the rate λ.

    A kink of the load, as the start, excites such modes. Those of the rate order/h are gone in steps long after it.
    """
    rate, grid, load = damping_rate(problem.systems, problem.load, problem.load_scale), problem.grid, problem.load
    what, sound = "damping slows the body down", "energy does not rise, but " * is_a_stable
    if load.memories and load.is_compiled and problem.internal is not None:
        q, W, z = directors(problem.quaternion[0]), problem.velocity[0], problem.internal[0]
        if (own := memory_rate(load, problem.t_start, q, W, z)) > rate:
            rate, what, sound = own, "internal states of the load decay", ""
    if not grid.longest * rate > order:
        return None
    h, kinks = np.array(grid.sizes), np.sort([grid.borders[0], *load.breakpoints])
    since = grid.borders[:-1] - kinks[np.searchsorted(kinks, grid.borders[:-1], side="right") - 1]
    coarse = h[(h * rate > order) & (order * since < GONE * h)]
    if not coarse.size:
        return None
    others = "none: a tolerance begins with steps as short"
    if not is_a_stable:
        others = "the integrator gauss, which takes damped modes in long steps"
    return (
        f"{what} at a rate of up to {rate:.3g} 1/s, which step = {coarse.max():.6g} s does not resolve: {sound}those "
        f"modes are wrong; try step <= {order / rate:.1g}, or {others}"
    )


def highest_frequency(load: Load) -> float:
    """Return that of the sines of a load, Hz, 0 without any."""
    return max((term.frequency for term in load.terms if isinstance(term, Sine)), default=0.0)


def undersampled(problem: IVP, nodes: int) -> str | None:
    """Return what to say of steps whose nodes see a sine of the load less than twice a period."""
    fastest, h = highest_frequency(problem.load), problem.grid.longest
    if not h * fastest > nodes / 2:
        return None
    return (
        f"a sine of the load has {fastest:.6g} Hz, which step = {h:.6g} s does not resolve: another moment acts; try "
        f"step <= {nodes / (20 * fastest):.1g}"
    )


def slowest_damping(systems: SystemStack, load: Load, scale: Array = ONE) -> Array:
    """Return the least rate ρ at which damping slows each member down, 1/s, (m,); 0 where it may not.

    As ``W·C W >= ρ W·J W``, it is the smallest eigenvalue of J^(-1/2) (C + Cᵀ)/2 J^(-1/2), across an axis.
    """
    if not load.damping.any():
        return np.zeros(len(systems))
    axes, turning = _body_axes(systems), _free_axes(systems)
    basis, root = axes.basis[:, :, turning], np.sqrt(axes.moments[:, turning])
    C = basis.mT @ ((load.damping + load.damping.T) / 2) @ basis / (root[:, :, None] * root[:, None, :])
    return np.maximum(np.linalg.eigvalsh(np.reshape(scale, (-1, 1, 1)) * C)[:, 0], 0.0)


def largest_velocity(
    systems: SystemStack,
    W: Array,
    load: Load,
    t_start: float,
    t_end: float,
    scale: Array = ONE,
    is_bound: bool = False,
    by_energy: bool = False,
    wheel_torque: Array | None = None,
) -> float:
    """Return what |w| of all members can reach, rad/s, as far as it follows from energy and impulse.

    With I the smallest moment of inertia about an axis that the body can turn about, |w| is at most sqrt(2 K / I), and
    K grows by the work of gravity, at most 2 Σ|f^i|, by what potentials vary, and by the impulse p of the load, to
    (sqrt(2 K) + p/sqrt(I))²/2.
    With the integral of |m| for p that is a bound, with the largest |∫ m dt| an estimate, nearer where signs change.

    Damping bounds it as well: as ``K' = W·M - W·C W``, with ω = J^(1/2) W, ``|ω|' <= |J^(-1/2) M| - ρ |ω|``
    (`slowest_damping`), so |ω| stays below the larger of its start and of |J^(-1/2) M|/ρ, M all moments.

    With wheels K is that of what carries them, of inertia J_c, on which their torques are moments -Σ τ n; their momenta
    turn W without work. Friction in their bearings is not counted.

    A slender body does not reach it by turning about its own axis t, of the smallest moment: from J_t W_t' =
    (J_i - J_j) W_i W_j + m_t, and J_i W_i² + J_j W_j² <= 2 K, its W_t is at most ``|W_t(0)| + (T |J_i - J_j|
    K/sqrt(J_i J_j) + ∫|m_t|) / J_t``. The weight on a director has no moment about this director; damping C drives W_t
    by the velocity across alone, at most sqrt(2 K/J_i), by the part of C t across t. As it slows W_t down at the rate
    C_tt/J_t, no more than the last J_t/C_tt of the time T counts.

    Parameters
    ----------
    systems : SystemStack
    W : (m, 3) array, rad/s
        At the start.
    load : Load
    t_start, t_end : float, s
    scale : (1,) or (m,) array
        Of the load.
    is_bound : bool
    by_energy : bool
        Let slender bodies turn about their own axis as fast as the energy allows: a solver whose state is the spatial
        momentum meets this rate, as it turns errors of the attitude into such velocities.
    wheel_torque : (1, w) or (m, w) array, N m, optional
        Beside the torques of the load, without its scale.
    """
    axes = _body_axes(systems)
    moments = axes.moments
    smallest = moments[:, _free_axes(systems)].min(axis=1)
    impulse, largest, torque = 0.0, 0.0, 0.0 if wheel_torque is None else abs(wheel_torque).sum(axis=1)
    if load.wheels:
        carrier = systems.convected_inertia - sum(one.locked for one in load.wheels)
        smallest = np.minimum(smallest, np.linalg.eigvalsh(carrier)[:, 0])
    if load.terms:
        span, samples = t_end - t_start, 2000
        times = t_start + span * (np.arange(samples) + 0.5) / samples
        moving, space = load.sample(times, "body"), load.sample(times, "space")
        if load.rotors:
            moving = moving - np.gradient(load.rotor_momentum(times), times, axis=0)
        for one in load.wheels:
            moving = moving - one.scale * one.torque_at(times)[:, None] * one.direction
        if is_bound:
            impulse = sum(float(np.linalg.norm(part, axis=1).sum()) for part in (moving, space)) * span / samples
        else:
            impulse = float(np.linalg.norm(np.cumsum(moving + space, axis=0), axis=1).max()) * span / samples
        forces_on = np.linalg.norm(forces_sampled(load, times).reshape(samples, 6, 3), axis=2).sum(axis=1)
        impulse += float(forces_on.sum()) * span / samples
        largest = float((np.linalg.norm(moving, axis=1) + np.linalg.norm(space, axis=1) + forces_on).max())
    spin = 0.0
    if systems.spin is not None:
        W, spin = _with_spin(systems, W, moments)
    K = np.sum(W * (systems.convected_inertia @ W[:, :, None])[:, :, 0], axis=1) / 2
    root = np.sqrt(2 * K) + (abs(scale) * impulse + torque * (t_end - t_start)) / np.sqrt(smallest)
    pull = np.linalg.norm(systems.dead_force, axis=2).sum(axis=1) + abs(scale) * potential_range(load) / 2
    energy = root**2 + 4 * pull
    slowest = slowest_damping(systems, load, scale)
    if slowest.any() and systems.spin is None and not (is_bound and load.potentials):
        free = _free_axes(systems)
        driven = np.linalg.norm(axes.pulls[:, free] / np.sqrt(moments[:, free]), axis=1)
        driven = driven + (abs(scale) * (largest + potential_range(load)) + torque) / np.sqrt(smallest)
        with np.errstate(divide="ignore", invalid="ignore"):
            energy = np.fmin(energy, np.maximum(2 * K, np.square(driven / slowest)))
    reached = np.sqrt(energy / smallest)
    is_driven = load.potentials or load.rotors or load.wheels or (is_bound and load.frictions)
    if systems.axis is None and not (by_energy or is_driven):
        reached = np.minimum(reached, _of_slender(axes, W, load, energy, t_end - t_start, scale, impulse))
    return float(np.hypot(reached.max(), spin))


def _of_slender(axes: Axes, W: Array, load: Load, energy: Array, span: float, scale: Array, impulse: float) -> Array:
    """Return what |w| can reach where about the axis of the smallest moment W only grows by moments; `energy`: 2 K."""
    basis, moments, pulls = axes
    order, rows = np.argsort(moments, axis=1), np.arange(len(moments))
    thin, middle, large = np.take_along_axis(moments, order, axis=1).T
    along, across = basis[rows, :, order[:, 0]], np.sqrt(energy / middle)
    damped = along @ load.damping
    damped -= np.sum(damped * along, axis=1, keepdims=True) * along
    drag = abs(scale) * np.linalg.norm(damped, axis=1) * across
    coupled = (large - middle) * energy / (2 * np.sqrt(large * middle))
    rate = np.maximum(scale * np.sum((along @ load.damping) * along, axis=1) / thin, 1e-300)
    driven = coupled + pulls[rows, order[:, 0]] + drag
    gained = np.minimum(span, 1 / rate) * driven + abs(scale) * impulse
    return np.hypot(abs(np.sum(along * W, axis=1)) + gained / thin, across)


def swing_rate(systems: SystemStack, load: Load, scale: Array = ONE) -> float:
    """Return about the fastest rate at which gravity and potentials make a member swing, rad/s, however slow it is.

    Damped at the rate ρ > 2ω, ``x'' + ρ x' + ω² x = 0`` does not swing but creeps, at ω²/(ρ/2 + sqrt(ρ²/4 - ω²)).
    """
    axes, turning = _body_axes(systems), _free_axes(systems)
    pulls = axes.pulls + np.reshape(abs(scale) * potential_range(load) / 2, (-1, 1))
    squares = pulls[:, turning] / axes.moments[:, turning]
    half = slowest_damping(systems, load, scale)[:, None] / 2
    rates = np.where(half**2 > squares, half + np.sqrt(np.maximum(half**2 - squares, 0.0)), np.sqrt(squares))
    return float(np.divide(squares, rates, out=np.zeros_like(squares), where=squares > 0).max())


def gyration_rate(systems: SystemStack, load: Load, t_start: float, t_end: float) -> float:
    """Return the fastest rate at which rotors and wheels make a member gyrate, rad/s, as far as momenta are known.

    With their momentum H relative to the body, ``J W' = H × W`` turns W at the rate ``sqrt(H·J H / det J)``.
    """
    if not (load.rotors or load.wheels):
        return 0.0
    times = np.linspace(t_start, t_end, MOMENTA)
    H = load.rotor_momentum(times) + sum((one.scale * one.inertia * one.speed * one.wheel for one in load.wheels), ZERO)
    h = H[np.square(H).sum(axis=1).argmax()]
    across, J = np.cross(h, np.eye(3)).T, systems.convected_inertia
    if systems.axis is not None:
        plane = bases_of(systems.axis)[:, :, :2]
        across, J = plane.mT @ across @ plane, plane.mT @ J @ plane
    return float(abs(np.linalg.eigvals(np.linalg.solve(J, np.broadcast_to(across, J.shape)))).max())


class Axes(NamedTuple):
    """The axes of bodies."""

    basis: Array  # (m, 3, 3) columns
    moments: Array  # (m, 3) of inertia about them
    pulls: Array  # (m, 3) N m, the largest moments of gravity about them: f^i has none about d_i


def _body_axes(systems: SystemStack) -> Axes:
    """Return the axes of each body."""
    return _axes_of_one(systems) if len(systems) == 1 else _axes_of(systems)


def _axes_of(systems: SystemStack) -> Axes:
    basis, E, M = frames(systems)
    e = E[:, range(3), range(3)]
    moments = (e.sum(axis=1, keepdims=True) - e) * M[:, None]
    across = np.sqrt(np.maximum(1 - np.square(basis), 0.0))  # |E_i × b_k|
    return Axes(basis, moments, (np.linalg.norm(systems.dead_force, axis=2)[:, :, None] * across).sum(axis=1))


_axes_of_one = lru_cache(maxsize=64)(_axes_of)


def _free_axes(systems: SystemStack) -> slice:
    """Return which axes the bodies can turn about: a constrained one is the last."""
    return slice(None if systems.axis is None else 2)


def _with_spin(systems: SystemStack, W: Array, moments: Array) -> tuple[Array, float]:
    """Return the velocities across the axes, as large as the free motion makes them, and the largest prescribed spin.

    They are bounded by the form J1 (J3 - J1) W1² + J2 (J3 - J2) W2², which stays; where it is not definite they grow,
    and a run shows how far.
    """
    spin, factor, axis = (getattr(systems, name) for name in ("spin", "spin_factor", "axis"))
    W = W - np.sum(W * axis, axis=1, keepdims=True) * axis
    form = moments[:, :2] * (moments[:, 2:] - moments[:, :2])
    least, most = np.sort(abs(form), axis=1).T
    is_definite = (form[:, 0] * form[:, 1] > 0) & (least > 1e-3 * most)
    growth = np.sqrt(np.divide(most, least, out=np.ones_like(most), where=is_definite))
    return growth[:, None] * W, float((abs(factor) * abs(spin.values).max()).max())


def potential_range(load: Load) -> float:
    """Return by how much the potentials of a load vary over attitudes, J, as far as some of them show."""
    if not load.potentials:
        return 0.0
    try:
        energies = load.potential_energy(_attitudes(), 0.0)
    except ValueError:  # a function that has no value everywhere: a run that comes there says so
        return 0.0
    return float(np.ptp(energies)) * VARIES


@cache
def _attitudes() -> Array:
    """Return the attitudes that are tried."""
    p = np.random.default_rng(0).standard_normal((200, 4))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return directors(np.concatenate([np.eye(4), p]))
