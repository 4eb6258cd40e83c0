"""The continuous equations through SciPy's solvers: the independent reference.

Either form of `models.equations` is integrated, together with the time integrals of the moment, of its power and of the
multipliers, from which the means over the stored intervals follow. Breakpoints of the load are integration limits; in
between, the load is evaluated strictly inside its interval, so that a jump belongs to one side. The solvers are driven
step by step, as `solve_ivp` does, so that the completed part is available when a run is interrupted.

Damping C. A body at rest has no error, so an explicit method may step far beyond its interval of stability as long as
the fast velocities are zero; round-off then grows by orders of magnitude in a step, and in its interpolant by more,
before the error at the end of the step shows it. Steps are therefore limited to the interval: z/ρ, with ρ the largest
eigenvalue of J⁻¹C, without n where the body may not turn about it.

Drift. Directors leave the unit length by the error of each step, and keep it: the equations turn them faster by as
much, so that the attitude is off by the error times the whole turn. An explicit method therefore goes on from the
nearest orthonormal directors, up to the square of what they are off by, ``q (3 - q qᵀ)/2``, and from the momenta or
velocities that fit them (Hairer, Lubich & Wanner, IV.4). Runs over a hundred radians become 60 to 10⁵ times more
accurate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any, ClassVar, Literal, Self

import numpy as np

from ..geometry.arrays import Array, as_number
from ..geometry.values import among, require_among, short_repr
from ..loads import Load
from ..loads.load import forces_at, moment_at
from ..loads.potentials import DirectorForces
from ..loads.terms import Damping
from ..models.equations import NO_FORCES, director_rates, hat, products, split_momentum, split_rates, split_velocity
from ..models.system import DirectorSystem
from .costs import Cost, damping_rate, largest_velocity
from .integrator import BEYOND_JUMPS, IVP, Failure, Integrator, March, Status

MOST = 1e6  # steps of the solver in a run, half an hour
CHECK_EVERY, PATIENCE = 1000, 1e5  # steps between checks of progress, 4 times as often for Radau; of a fast start
LEAP, NEXT = 0.1, 100  # of a moment: what it changes by within so many steps where it jumps
BLOCK, STUCK = 2000, 1e-6  # steps; of the time left: what a million steps at the pace of these make at least
TURNED = 6  # integrals of W and of t W, for the work of motors
DIVERGED = 1e3  # component of a director
STATE_NS, STEP_NS, STARTS = 100_000, 2_000_000, 2  # of an output, of a step of the solver; steps of its start
SMALLEST = 1e-292  # tolerance: where it and the value are 0, SciPy's first step is NaN, which it shortens for ever
TOO_FAST = (
    "SciPy's {} would need more than {:g} steps, after {} it has come {:.1e} s far: the body turns or is damped too "
    "fast"
)
JUMPS = (
    "SciPy's {} is stuck at t = {:.9g} s, in steps of about {:.0e} s, as moments jump with the state there, one of "
    "them from {:.4g} to {:.4g} N m; " + BEYOND_JUMPS
)
TURNS = {  # rad that a free body turns in a step are a rtol^(1/p), as measured: a, p
    "RK23": (3.0, 3), "RK45": (3.5, 5), "DOP853": (4.2, 9), "Radau": (3.1, 4), "BDF": (0.63, 7), "LSODA": (0.36, 10),
}  # fmt: skip
METHODS = tuple(TURNS)
RESOLVED = 0.3  # rad of a sine in the longest step that resolves it
STABLE = {"RK23": 2.5, "RK45": 3.3, "DOP853": 6.3}  # z: of explicit methods, |R(-z)| ≤ 1 on the real axis
NO_MOMENT = np.zeros(3)


@dataclass(frozen=True)
class Continuous(Integrator):
    """Adaptive integration of the continuous equations, with output at any times.

    Parameters
    ----------
    method : str
        Method of `scipy.integrate.solve_ivp`.
    rtol, atol : float
        Relative and absolute tolerances. `atol` is scaled by units of the problem: 1 for directors; for momenta and
        velocities their values at the start, or, where a load or gravity acts, at least those of a turn by 1 rad in the
        whole run.
    form : "split" or "director"
        Rotations with split momenta (multipliers: μ), or constrained directors (multipliers: λ, μ).

    Raises
    ------
    ValueError
        `method` or `form` is unknown, or a tolerance is not between 0 and 1.

    Notes
    -----
    A step takes 0.5 to 3 ms. A warning is issued if a run is expected to take more than 10 s. A run is aborted after a
    million steps, about half an hour, and where it is stuck because a load jumps with the state.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.integrators import Continuous
    >>> scheme = Continuous(rtol=1e-9, atol=1e-11)
    >>> run = simulate(standard([3, 4, 5]), times=[0, 1, 2], material_angular_velocity=(0.1, 2, 0.1), integrator=scheme)
    >>> run.kinetic_energy.values.round(6)
    array([8.04, 8.04, 8.04])
    """

    name: ClassVar[str] = "continuous"
    any_times: ClassVar[bool] = True
    compared: ClassVar[tuple[float, ...]] = (1e-6, 1e-9, 1e-12)  # tolerances
    method: str = "DOP853"
    rtol: float = 1e-12
    atol: float = 1e-14
    form: Literal["split", "director"] = "split"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not among(self.method, METHODS):
            raise ValueError(f"method must be one of {', '.join(METHODS)}; got {short_repr(self.method)}")
        require_among(self.form, "form", ("split", "director"))
        for name in ("rtol", "atol"):
            if not 0 < as_number(getattr(self, name), name) < 1:
                raise ValueError(f"{name} must be between 0 and 1, got {short_repr(getattr(self, name))}")

    @classmethod
    def variants(cls) -> list[Self]:
        """Return one instance for every tolerance used by `compare`."""
        return [cls(rtol=rtol, atol=rtol / 100) for rtol in cls.compared]

    def cost(self, problem: IVP, states: int) -> Cost:
        """Return the cost of the outputs and of the steps expected from energy, impulse and damping."""
        steps = min(MOST, expected_steps(self, problem))
        return Cost(states, "states", (states * STATE_NS + steps * STEP_NS) * 1e-9, 0)

    def march_one(self, problem: IVP) -> March:
        """Integrate `problem` to its output times."""
        system = problem.system
        if system.spin is not None and self.form == "director":
            raise ValueError("form='director' has no prescribed spin; Continuous(form='split') has")
        form: Any = _Director(system) if self.form == "director" else _Split(system)
        if system.spin is not None:
            form = _PrescribedSpin(system, problem.t_start)
        state = form.start(problem.directors, problem.velocities)
        size, c = len(state), form.multipliers
        y = np.concatenate([state, np.zeros(4 + c + TURNED * problem.load.drives)])
        how: dict[str, Any] = {"rtol": self.rtol, "atol": np.maximum(self.atol * _sizes(problem, form), SMALLEST)}
        if self.method in STABLE and 0 < (rate := damping_rate(problem.systems, problem.load)) < np.inf:
            how["max_step"] = STABLE[self.method] / rate
        taken, states = count(1), [y] if problem.stored_times[0] == problem.t_start else []

        def failure_of(status: Status, reason: str | Exception) -> Failure:
            return problem.failed(len(states), status, reason)

        @np.errstate(over="ignore", invalid="ignore")  # of trials that the solver rejects
        def failure_between(a: float, b: float) -> Failure | None:
            """Integrate from a to b and keep the states at the output times; return the failure."""
            nonlocal y
            rates = _rates(problem, form, np.nextafter(a, b), np.nextafter(b, a), self.method in STABLE)
            times = problem.stored_times[len(states) : np.searchsorted(problem.stored_times, b, side="right")]
            solver = solver_of(self.method)(rates, a, y, b, **how)
            done, steps, mark, every = 0, 0, a, CHECK_EVERY // (4 if self.method == "Radau" else 1)
            while solver.status == "running":
                message = solver.step()
                steps += 1
                expected = steps * min(1, steps / PATIENCE) * (b - a)  # steps to b at the pace so far, times t - a
                if next(taken) > MOST or (steps % every == 0 and expected > MOST * (solver.t - a)):
                    return failure_of(Status.TOO_MANY, TOO_FAST.format(self.method, MOST, steps, solver.t - a))
                if steps % BLOCK == 0 and self.method in STABLE and problem.load.depends_on_state:
                    if reason := self._stuck(solver, (solver.t - mark) / BLOCK, slice(size, size + 3)):
                        return failure_of(Status.JUMP, reason)
                    mark = solver.t
                if solver.status == "failed":
                    return failure_of(Status.SOLVER, f"SciPy's {self.method} gave up: {message}")
                until = int(np.searchsorted(times, solver.t, side="right"))
                if until > done:
                    states.extend(solver.dense_output()(times[done:until]).T)
                    done = until
                if self.method in STABLE:
                    solver.y = form.projected(solver.y)
                    solver.f = solver.fun(solver.t, solver.y)
            y = solver.y
            return None

        try:
            failure = next(filter(None, (failure_between(a, b) for a, b in pairwise(_limits(problem)))), None)
        except ValueError as error:
            failure = failure_of(Status.LOAD, error)
        except KeyboardInterrupt as stop:
            failure = failure_of(Status.INTERRUPTED, str(stop))
        return _march(problem, form, np.array(states).reshape(-1, len(y)), size, failure)

    def _stuck(self, solver: Any, pace: float, moment: slice) -> str:
        """Return what to say of steps that lead nowhere, this long, where moments jump between the next few of them."""
        near = [solver.fun(solver.t, solver.y + s * NEXT * pace * solver.f)[moment] for s in (-1, 1)]
        k = int(np.argmax(abs(near[1] - near[0])))
        is_smooth = abs(near[1] - near[0])[k] <= LEAP * max(abs(near[0]).max(), abs(near[1]).max())
        if is_smooth or pace * MOST > STUCK * (solver.t_bound - solver.t):
            return ""
        return JUMPS.format(self.method, solver.t, pace, near[0][k], near[1][k], "dry_friction")


def solver_of(method: str) -> Any:
    """Return a solver of SciPy, whose package takes half a second to import."""
    import scipy.integrate

    return getattr(scipy.integrate, method)


def least_steps(scheme: Continuous, problem: IVP) -> float:
    """Return how many steps damping asks for at least: longer ones of explicit methods are not stable."""
    rate = damping_rate(problem.systems, problem.load)
    return (problem.t_end - problem.t_start) * rate / STABLE.get(scheme.method, np.inf)


@np.errstate(all="ignore")
def expected_steps(scheme: Continuous, problem: IVP) -> float:
    """Return the expected number of steps of the solver; loads that are functions are not considered."""
    a, p = TURNS[scheme.method]
    known = Load(tuple(term for term in problem.load.terms if "function" not in term.description))
    span = problem.t_start, problem.t_end
    fastest = largest_velocity(problem.systems, problem.velocity, known, *span, by_energy=True)
    rate = max(fastest, RESOLVED / problem.load.resolution) / (a * scheme.rtol ** (1 / p))
    steps = max(rate * (problem.t_end - problem.t_start), least_steps(scheme, problem))
    return float(steps + STARTS * (len(_limits(problem)) - 1))


class _Split:
    """State (q, π_⊥, π_∥)."""

    size = 13

    def __init__(self, system: DirectorSystem) -> None:
        self.system, self.multipliers = system, 0 if system.axis is None else 1

    def start(self, q: Array, v: Array) -> Array:
        w = products(q, v) / 2
        perp, par = split_momentum(self.system, q, (self.system.convected_inertia @ (q @ w)) @ q)
        return np.concatenate([q.ravel(), perp, [par]])

    def velocities(self, y: Array) -> tuple[Array, Array]:
        q, w = self.motion(y)
        return q, q @ hat(w).T

    def motion(self, y: Array) -> tuple[Array, Array]:
        q = y[:9].reshape(3, 3)
        return q, split_velocity(self.system, q, y[9:12], float(y[12]))

    def projected(self, y: Array) -> Array:
        """Return a state with orthonormal directors, and π_⊥ orthogonal to d."""
        y, q = _with_unit_directors(y)
        d = q[2] if self.system.axis is None else self.system.axis @ q
        y[9:12] -= (y[9:12] @ d) * d
        return y

    def set_rates(self, dy: Array, y: Array, q: Array, w: Array, moment: Array, forces: Array) -> None:
        total = moment if forces is NO_FORCES else moment + products(q, forces)
        directors, dy[9:12], dy[12], mu = split_rates(self.system, q, y[9:12], float(y[12]), total, w)
        dy[:9] = directors.ravel()
        dy[self.size + 4 : self.size + 4 + self.multipliers] = mu


class _PrescribedSpin(_Split):
    """State (q, W) of a body with a prescribed spin; `rate` is that of the spin between two of its kinks."""

    size = 12

    def __init__(self, system: DirectorSystem, t_start: float) -> None:
        self.system, self.multipliers, self.rate = system, 1, 0.0
        self.first = float(system.spin.at(t_start))

    def start(self, q: Array, v: Array) -> Array:
        n, W = self.system.axis, q @ (products(q, v) / 2)
        assert n is not None
        return np.concatenate([q.ravel(), W + (self.first - n @ W) * n])

    def begin(self, first: float, last: float) -> None:
        """Take the rate of the spin between two times."""
        at_first, at_last = self.system.spin.at([first, last])
        self.rate = float((at_last - at_first) / (last - first))

    def motion(self, y: Array) -> tuple[Array, Array]:
        q = y[:9].reshape(3, 3)
        return q, y[9:12] @ q

    def projected(self, y: Array) -> Array:
        """Return a state with orthonormal directors."""
        return _with_unit_directors(y)[0]

    def set_rates(self, dy: Array, y: Array, q: Array, w: Array, moment: Array, forces: Array) -> None:
        J, n, W = self.system.convected_inertia, self.system.axis, y[9:12]
        assert n is not None
        total = moment + products(q, self.system.dead_force)
        if forces is not NO_FORCES:
            total = total + products(q, forces)
        free = np.linalg.solve(J, np.cross(J @ W, W) + q @ total)
        dy[:9], dy[9:12] = (q @ hat(w).T).ravel(), free + (self.rate - n @ free) * n
        dy[self.size + 4 : self.size + 5] = (n @ free - self.rate) * (n @ J @ n)  # n is principal


class _Director:
    """State (q, v)."""

    size = 18

    def __init__(self, system: DirectorSystem) -> None:
        self.system, self.multipliers = system, 6 if system.axis is None else 7

    def start(self, q: Array, v: Array) -> Array:
        return np.concatenate([q.ravel(), v.ravel()])

    def velocities(self, y: Array) -> tuple[Array, Array]:
        return y[:9].reshape(3, 3), y[9:18].reshape(3, 3)

    def motion(self, y: Array) -> tuple[Array, Array]:
        q, v = self.velocities(y)
        return q, products(q, v) / 2

    def projected(self, y: Array) -> Array:
        """Return a state with orthonormal directors, which turn with one angular velocity."""
        y, q = _with_unit_directors(y)
        y[9:18] = (q @ hat(products(q, y[9:18].reshape(3, 3)) / 2).T).ravel()
        return y

    def set_rates(self, dy: Array, y: Array, q: Array, w: Array, moment: Array, forces: Array) -> None:
        v_dot, dy[self.size + 4 : self.size + 4 + self.multipliers] = director_rates(
            self.system, q, y[9:18].reshape(3, 3), moment, forces
        )
        dy[:9], dy[9:18] = y[9:18], v_dot.ravel()


def _with_unit_directors(y: Array) -> tuple[Array, Array]:
    """Return a copy of a state, and its directors, orthonormal up to the square of what they were off by."""
    y = y.copy()
    q = y[:9].reshape(3, 3)
    q[:] = 1.5 * q - 0.5 * (q @ q.T) @ q
    return y, q


def _rates(problem: IVP, form: Any, first: float, last: float, may_reject: bool) -> Callable[[float, Array], Array]:
    """Return dy/dt; NaN, on which explicit methods shorten the step, where directors of a trial are far from unit."""
    if isinstance(form, _PrescribedSpin):
        form.begin(first, last)
    load, potentials = problem.load.without_potentials, Load(problem.load.potentials)
    forces = Load(tuple(term for term in load.terms if isinstance(term, DirectorForces)))
    moments = Load(tuple(term for term in load.terms if term not in forces.terms))
    has_forces, size, drives = bool(forces.terms or potentials.terms), form.size, problem.load.drives

    def rates(t: float, y: Array) -> Array:
        if may_reject and not abs(y[:9]).max() < DIVERGED:
            return np.full_like(y, np.nan)
        q, w = form.motion(y)
        at = min(max(t, first), last)
        m, dy = moment_at(moments, at, q, w) if moments.terms else NO_MOMENT, np.empty_like(y)
        if has_forces:
            F = forces_at(forces, at, q, w)
            form.set_rates(dy, y, q, w, m, F + forces_at(potentials, at, q, w))
            m = m + products(q, F)
        else:
            form.set_rates(dy, y, q, w, m, NO_FORCES)
        dy[size : size + 3], dy[size + 3] = m, 0.0 if m is NO_MOMENT else m @ w
        if drives:
            dy[-6:-3], dy[-3:] = q @ w, at * (q @ w)
        return dy

    return rates


def _sizes(problem: IVP, form: Any) -> Array:
    """Return the size of every part of the state: directors, momenta or velocities, integrals, multipliers."""
    q, v = problem.directors, problem.velocities
    J, T = problem.system.convected_inertia, problem.t_end - problem.t_start
    W = q @ np.cross(q, v).sum(0) / 2
    if problem.system.spin is not None and problem.system.axis is not None:
        W = W + abs(problem.system.spin.values).max() * problem.system.axis
    speed, momentum = float(np.linalg.norm(W)), float(np.linalg.norm(J @ W))
    driven = any(not isinstance(term, Damping) for term in problem.load.terms)
    if speed == 0 or driven or problem.system.dead_force.any():
        speed, momentum = max(speed, 1 / T), max(momentum, float(np.linalg.norm(J, 2)) / T)
    moving = [momentum] * 4 if type(form) is _Split else [speed] * (form.size - 9)
    velocity_integrals = ([1.0] * 3 + [max(abs(problem.t_start), abs(problem.t_end))] * 3) * problem.load.drives
    return np.array(
        [1.0] * 9 + moving + [momentum] * 3 + [momentum * speed] + [momentum] * form.multipliers + velocity_integrals
    )


def _limits(problem: IVP) -> Array:
    last = float(problem.stored_times[-1])
    spin = problem.system.spin
    known = (*problem.load.breakpoints, *(() if spin is None else spin.breakpoints))
    inner = [t for t in known if problem.t_start < t < last]
    return np.unique([problem.t_start, *inner, last])


def _march(problem: IVP, form: Any, y: Array, size: int, failure: Failure | None) -> March:
    pairs = [form.velocities(row) for row in y]
    q, v = (np.array([pair[k] for pair in pairs]).reshape(-1, 3, 3) for k in (0, 1))
    sums, lengths = np.diff(y[:, size:], axis=0), np.diff(problem.stored_times[: len(y)])[:, None]
    ends, velocity_integrals = 4 + form.multipliers, sums[:, 4 + form.multipliers :] if problem.load.drives else None
    return March(q, v, sums[:, 4:ends] / lengths, sums[:, :3] / lengths, sums[:, 3], None, failure, velocity_integrals)
