"""The plan of a run or an ensemble, without its start: integrator, bodies, load and times, checked once."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from operator import itemgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import LARGEST, Array, as_number, as_positive
from ..geometry.attitudes import directors
from ..geometry.values import nearest, short_repr
from ..integrators import DEFAULT, INTEGRATORS, IVP, Integrator
from ..integrators.continuous import METHODS
from ..integrators.costs import damping_at, damping_rate, largest_velocity, memory_rate, slowest_damping
from ..integrators.ivp import Segments, segmented
from ..integrators.load_samples import carrier
from ..integrators.load_samples import first_internal_states as first_states
from ..loads import Load, Term, as_load, damping
from ..loads.load import of_body
from ..loads.memory_terms import carried_on
from ..loads.potentials import GravityGradient
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from .grid import (
    CLOSEST,
    FEWEST,
    MOST,
    TURN,
    Piecewise,
    as_store,
    checked_output_times,
    count_steps,
    joined_grid,
    kinks,
    segments_of,
    steady,
    stored_count,
    stored_steps,
    with_spin_kinks,
)
from .starts import Starts

LARGEST_TOLERANCE = 0.1
SETTLES, FAR, NOTHING = 10.0, 1000.0, 1e-16  # how much less a body turns; rad; a part of a velocity
SOME = 32  # members and breakpoints at most, for which loads are linearised


class Plan(NamedTuple):
    """A problem without its start and, where it is chosen for each start, without its grid."""

    scheme: Integrator
    systems: SystemStack
    load: Load
    t_start: float
    t_end: float
    store: int | Literal["end"]
    grid: Segments | None  # None: chosen for the start
    output_times: Array | None  # they need not lie on a grid
    tolerance: float | None = None
    schemes: tuple[Integrator, ...] = ()  # of which a tolerance chooses one
    shows: Literal["steps", "between", "nothing"] = (
        "steps"  # what gives states near enough for figures: steps are short
    )
    means: bool = True  # whether means over the stored intervals are computed, most of what a run holds

    @property
    def goal(self) -> float:
        """The tolerance, that of the integrator where none is given; 0 where it has none."""
        return self.tolerance or self.scheme.automatic or 0.0

    @property
    def grid_load(self) -> Load:
        """The load for time grids, which have the kinks of a prescribed spin as well."""
        return with_spin_kinks(self.load, self.systems)

    @property
    def is_controlled(self) -> bool:
        """Whether steps are chosen by a tolerance."""
        return self.grid is None and self.goal > 0

    @property
    def is_shown(self) -> bool:
        """Whether steps that nobody has chosen are stored: figures and analyses are made from their states."""
        return self.tolerance is None and self.store != "end" and self.shows != "nothing" and not self.is_between

    @property
    def is_between(self) -> bool:
        """Whether such states are found between steps, however long these are."""
        is_open = self.tolerance is None and self.store != "end" and self.shows == "between"
        return is_open and self.scheme.has_series(self.systems, self.load)

    @property
    def of_steps(self) -> Plan:
        """The plan of the run that finds the steps: without the outputs that are found on them, or between."""
        if self.output_times is None and not self.is_between:
            return self
        shows = "nothing" if self.scheme.has_series(self.systems, self.load) else self.shows
        return self._replace(output_times=None, store=1, shows=shows)

    @property
    def off_grid(self) -> bool:
        """Whether the integrator takes no steps, but goes from output time to output time."""
        return self.output_times is not None and self.scheme.any_times

    def states(self, grid: Segments) -> int:
        """Return how many states are stored of a run on a grid; a ValueError where they do not fit into memory."""
        return stored_count(grid.steps, self.store) if self.output_times is None else len(self.output_times)

    def linearised(self, begin: Starts) -> Plan:
        """Return the plan from which steps are estimated: with the damping that functions of the state are at a start.

        It is the largest of some members, and of the first between some of the breakpoints. Functions in Python are
        called at the stages of given steps alone.
        """
        load = self.load
        if self.scheme.any_times or not load.called.terms or (self.grid is not None and not load.is_compiled):
            return self
        called, slowest = load.called, 1 / (self.t_end - self.t_start)
        borders = [self.t_start, *_some(kinks(called, self.t_start, self.t_end))]
        later = [(a + b) / 2 for a, b in pairwise([*borders, self.t_end])] if len(borders) > 1 else []
        states = [*zip(directors(_some(begin.quaternion)), _some(begin.velocity), strict=True)]
        points = [*((self.t_start, *state) for state in states), *((t, *states[0]) for t in later)]
        found = [damping_at(called, *point, slowest) for point in points]
        size, C = max(((float(abs(C).max()), C) for C in found), key=itemgetter(0))
        return self._replace(load=load + damping(C / max(1.0, size / LARGEST)))

    def remark(self, begin: Starts, problem: IVP) -> str | None:
        """Return what the integrator says about the steps of a problem, or None."""
        load = self.linearised(begin).load
        return self.scheme.remark(problem if load is problem.load else replace(problem, load=load))

    def decay(self, begin: Starts) -> float:
        """Return the largest rate at which anything decays at a start, 1/s, about."""
        rate = damping_rate(self.systems, self.load, begin.load_scale)
        if not self.load.memories:
            return rate
        z = internal_states(self.systems, self.load, begin, self.t_start)
        assert z is not None
        states = zip(directors(_some(begin.quaternion)), _some(begin.velocity), _some(z), strict=True)
        return max(rate, *(memory_rate(self.load, self.t_start, *state) for state in states))

    def fastest(self, begin: Starts, is_bound: bool = False) -> float:
        """Return the largest |w| of its runs from a start, rad/s: about, or a bound."""
        load = self.load if is_bound else self.linearised(begin).load
        return self._largest(begin, begin.velocity, load, is_bound)

    def _largest(self, begin: Starts, W: Array, load: Load, is_bound: bool = False) -> float:
        """Return the largest |w| of its runs from a start with other velocities, and under another load."""
        times, torque = (self.t_start, self.t_end), begin.wheel_torque
        return largest_velocity(self.systems, W, load, *times, begin.load_scale, is_bound, wheel_torque=torque)

    def pace(self, begin: Starts, fastest: float) -> Piecewise:
        """Return about the largest |w| of its runs as time goes on, rad/s; `fastest`: the largest of all.

        Moments M and damping C, ρ its slowest rate, bound ω = J^(1/2) W by ``|ω|' <= |J^(-1/2) M| - ρ |ω|``, so
        ``|ω(t)| <= |ω(0)| exp(-ρ t) + max |J^(-1/2) M|/ρ``. The velocity of a start turns the body by |ω(0)|/ρ in all,
        however long the run is; from some 1/ρ on the body turns as if it had begun at rest. The times are some of
        `graded`. There is one piece unless the body turns `SETTLES` times less than at `fastest`. Of functions of the
        state, the load is `linearised`, damping is known at the start alone: they need to turn the body `FAR`.
        """
        load, span, whole = self.load, self.t_end - self.t_start, fastest * (self.t_end - self.t_start)
        rate = 0.0 if self.systems.spin else float(slowest_damping(self.systems, load, begin.load_scale).min())
        called, one = load.called, steady(self.t_start, fastest)
        is_known = not (load.memories or (called.terms and (whole < FAR or called.breakpoints)))
        if not (is_known and whole > 0 and rate * span > SETTLES):
            return one
        at_rest = np.zeros_like(begin.velocity)
        driven = max(self._largest(begin, at_rest, load), NOTHING * fastest)
        decay = damping_rate(self.systems, load, begin.load_scale)
        first, last = np.ceil(np.log2(decay / rate * np.array([1.0, max(1.0, np.log(fastest / driven))])))
        since = 2.0 ** np.arange(first, last + 1) / decay
        since = since[(since < span) & (since > CLOSEST * np.spacing(abs(self.t_start) + since))]
        left = np.append(fastest, driven + fastest * np.exp(-rate * since))
        pace = Piecewise(self.t_start + np.append(0.0, since), np.minimum(left, fastest))
        return pace if SETTLES * (pace.lengths(self.t_end) @ pace.values) < whole else one

    def automatic(self, begin: Starts, longest: float | None = None, is_bound: bool = False) -> Segments:
        """Return a grid for at most 0.05 rad a step: by a bound, or an estimate to be verified by the run.

        The run then knows how long they may be, `longest`. Modes that decay faster are resolved while they last, or,
        unless the integrator is A-stable, all the time.

        Raises
        ------
        ValueError
            Too many steps; a bound is required, and the load is a function of the state, which has none.
        """
        if is_bound and self.load.called.terms:
            raise ValueError("a load that is a function of the state has no bound: give step=")
        load = (self if is_bound else self.linearised(begin)).grid_load
        if longest is None:
            fastest = self.fastest(begin, is_bound)
            longest = min((self.t_end - self.t_start) / FEWEST, TURN / fastest if fastest else np.inf)
        rate, span = damping_rate(self.systems, load, begin.load_scale), (self.t_start, self.t_end)
        if not longest * rate > 1:
            return segments_of(load, *span, longest)
        longest, part = (longest, TURN) if self.scheme.is_a_stable else (1 / rate, 1.0)
        try:
            return segments_of(load, *span, longest, decay=rate, part=part)
        except ValueError:
            from .first_steps import damped_steps

            if steps := damped_steps(self, begin):
                raise ValueError(
                    f"the automatic step would take more than {MOST:.0e} steps, as damping is so fast; choose {steps}"
                ) from None
            raise

    def problem(self, begin: Starts, grid: Segments, stored: NDArray[np.int64] | None = None, **options: Any) -> IVP:
        """Return the problem of the plan with a start; `stored`: the numbers of the stored steps; options of it."""
        if stored is None:
            stored = stored_steps(grid.steps, "end" if self.output_times is not None else self.store)
        if not self.off_grid:
            grid = joined_grid(begin.grid, grid)
        return IVP(
            self.systems,
            begin.quaternion,
            begin.velocity,
            self.load,
            self.t_start,
            self.t_end,
            grid.steps,
            stored,
            begin.load_scale,
            output_times=self.output_times,
            off_grid=self.off_grid,
            normal=begin.normal,
            memory=begin.memory,
            internal=internal_states(self.systems, self.load, begin, self.t_start),
            segments=grid,
            wheel_torque=begin.wheel_torque,
            **options,
        )


def planned(
    system: DirectorSystem | SystemStack,
    load: Load | Term | None = None,
    integrator: str | Integrator = DEFAULT,
    order: int | None = None,
    t_start: float | None = None,
    t_end: float | None = None,
    times: ArrayLike | None = None,
    step: float | None = None,
    store: int | Literal["end"] = 1,
    start_time: float | None = None,
    tolerance: float | None = None,
) -> Plan:
    """Return the checked plan; parameters as in `nontwist.simulate`, `start_time` the end of the run to continue.

    Raises
    ------
    ValueError
        Wrong input; the message names the value.
    """
    scheme, systems = resolve_integrator(integrator, order), stacked(system)
    if tolerance is not None:
        tolerance = checked_tolerance(tolerance, scheme, step)
    is_open = isinstance(integrator, str) and order is None
    t0 = as_number(t_start, "t_start") if t_start is not None else start_time or 0.0
    store = as_store(store)
    output_times = None if times is None else checked_output_times(scheme, times, t0, t_end, step, store)
    if output_times is not None and t_end is None:
        t1 = float(output_times[-1])
    elif t_end is not None:
        t1 = as_number(t_end, "t_end")
    else:
        raise ValueError("give t_end= or times=")
    if not t1 > t0:
        raise ValueError(f"t_end must be after t_start, got t_start = {t0:g} s, t_end = {t1:g} s")
    if step is None and t1 - t0 < 1e-312:
        raise ValueError(f"t_end = {t1:g} s is less than 1e-312 s after t_start; choose another unit of time")
    steps = None if step is None else count_steps(t1 - t0, step)
    if output_times is not None and scheme.any_times:
        steps = 1
    grid = None if steps is None else segmented((t0, t1), (steps,))
    load = as_load(load)
    if load.terms:
        load = fitting(load, scheme, systems)
    schemes = candidates(scheme, is_open) if grid is None else (scheme,)
    return Plan(scheme, systems, load, t0, t1, store, grid, output_times, tolerance, schemes)


def fitting(load: Load, scheme: Integrator, systems: SystemStack) -> Load:
    """Return a load that knows the body; a ValueError where it does not go with integrator, bodies or friction."""
    load = known_body(load, systems)
    scheme.require_memory(load)
    for k in range(len(systems)) if load.wheels else ():
        carrier(systems[k], load)
    return load


def _some(values: Array) -> Array:
    """Return some of many values, the first and the last among them."""
    return values[np.linspace(0, len(values) - 1, min(len(values), SOME)).astype(int)]


def require_observed(scheme: Integrator, load: Load) -> None:
    """Raise a ValueError where an integrator takes no steps to compute statistics over, or energy is not conserved."""
    if not scheme.observes:
        raise ValueError(f"{scheme.name} takes no steps to reduce over; store states with times=, or use {DEFAULT}")
    if any(isinstance(term, GravityGradient) for term in load.potentials):
        raise ValueError(
            "reduce= does not support gravity_gradient, whose energy depends on time; leave it out, and store the "
            "variable potential_energy"
        )


def internal_states(systems: SystemStack, load: Load, begin: Starts, time: float) -> Array | None:
    """Return the internal states of loads with memory at a start, (m, k), None: none; a ValueError for others."""
    if not load.remembering:
        return None
    if begin.internal is None:
        return first_states(systems, load, time, begin.velocity, begin.load_scale)
    had, own, size = begin.wheels, [wheel.count for wheel in load.wheels], load.internal_state.size
    z = carried_on(begin.internal, had, own)
    for what, found, count in (("wheels", len(had or own), len(own)), ("internal states", z.shape[1], size)):
        if found != count:
            raise ValueError(
                f"start= ends with another number of {what}, {found}, than the load has, {count}; continue with the "
                "load of that run, or start from its rotation and angular velocity, with speed= of wheels"
            )
    return np.broadcast_to(z, (len(begin.quaternion), z.shape[1]))


def known_body(load: Load, systems: SystemStack) -> Load:
    """Return a load that knows the body, which the gravity gradient needs; a ValueError where there are several."""
    J = systems.inertia
    own = of_body(load, J[0])
    if own is not load and (J[0] != J).any():
        raise ValueError(
            "gravity_gradient requires members of equal inertias; a sweep takes others, as with over={'body.inertia': "
            "[J1, J2]}"
        )
    return own


def checked_tolerance(tolerance: float, scheme: Integrator, step: float | None) -> float:
    """Return the tolerance of a run; a ValueError where it is none, or none is possible."""
    if step is not None:
        raise ValueError("give step= or tolerance=, not both")
    if scheme.any_times:
        own = "; its own are Continuous(rtol=..., atol=...)" if scheme.name == "continuous" else ""
        raise ValueError(f"{scheme.name} has no steps that tolerance= could choose{own}")
    found = float(as_positive(tolerance, "tolerance", (), "rad"))
    if found > LARGEST_TOLERANCE:
        raise ValueError(f"tolerance must be at most {LARGEST_TOLERANCE:g} rad, got {found:g}")
    return found


def candidates(scheme: Integrator, is_open: bool) -> tuple[Integrator, ...]:
    """Return the integrators of which a tolerance chooses: this one, in other orders too where the order is open."""
    orders = scheme.controlled_orders or tuple(order for order in scheme.orders if order >= 4) or scheme.orders
    return tuple(replace(scheme, order=order) for order in orders) if is_open and orders else (scheme,)  # type: ignore[call-arg]


def resolve_integrator(integrator: str | Integrator, order: int | None) -> Integrator:
    """Return the integrator of a name or an instance, of the given order."""
    if isinstance(integrator, Integrator):
        if order is not None:
            raise ValueError("an integrator given as an instance brings its order; leave order= out")
        return integrator
    if not isinstance(integrator, str) or integrator not in INTEGRATORS:
        known = nearest(integrator, INTEGRATORS)
        if isinstance(integrator, str) and (method := {one.lower(): one for one in METHODS}.get(integrator.lower())):
            known = f"{method} of SciPy is integrators.Continuous({method!r}); {known}"
        if isinstance(integrator, type) and issubclass(integrator, Integrator):
            known = f"an instance is taken: {integrator.__name__}()"
        raise ValueError(f"unknown integrator {short_repr(integrator)}; {known}")
    scheme = INTEGRATORS[integrator]
    if order is None:
        return scheme()
    if not scheme.orders:
        raise ValueError(f"{integrator} has no option order; got order = {order!r}")
    return scheme(order=int(order) if isinstance(order, np.integer) else order)  # type: ignore[call-arg]
