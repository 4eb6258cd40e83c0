"""The steps that a run to a tolerance begins with: the order, the grid, and what resolves damped modes.

A local estimate chooses the step h of each order p. A step misses the turn θ of a steady rotation by about
``c θ^(p+1)`` (`Integrator.lag`), so a run over the time T at the rate α misses ``T c α^(p+1) h^p``. α is that of W,
or of a swing under gravity and potentials, the larger. The order whose steps cost least is taken.
Nothing else relies on this estimate. It is too careful as a rule, which costs orders up to 4 most: their first steps
are four times as long.
Damping at the rate λ counts for α as well, unless the integrator is A-stable. Then modes that decay faster are
resolved only while they last: the start and every kink of a load excite them, and at the time t behind it those left
have rates up to about 1/t. So steps begin at ``h = x/λ``, x by the estimate over T = 1/λ, and from t = 1/λ on are
x t, until they are those of the motion (`grid.graded`): a number of steps like log(λ T), for all rates together.
A velocity at the start that damping takes away counts while it lasts (`Plan.pace`): with α(t) the larger of the
rates at the time t, steps are ``h = θ/α(t)``, where a turn by ∫ α dt in steps of θ is off by what is asked for.
Functions of the state count with the damping that they are at the start (`Plan.linearised`), loads with memory with
the rates at which their internal states decay there.

In between the stored states of a run whose steps nobody has chosen the body turns by at most 0.05 rad, and by at most
0.2 rad of the phase of a swing: figures, twist angles and extrema are made from these states. Where they are found
between the steps (`integrators.dense`), steps are as long as the tolerance allows; otherwise as short as that.
"""

from __future__ import annotations

from functools import lru_cache
from math import pi
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import EPS, Array
from ..integrators import Integrator
from ..integrators.costs import gyration_rate, highest_frequency, slowest_damping, swing_rate
from ..integrators.gauss import Gauss
from ..integrators.ivp import Segments, segmented
from ..integrators.lie_midpoint import LieMidpoint
from .grid import FEWEST, HIGHER, MOST, TURN, Piecewise, even_step, segments_of, steady
from .planning import Plan, candidates
from .starts import Starts

TENTH = 0.1  # of the tolerance: what the estimate asks for
HARMONICS = 1.5  # rates in a motion over the largest |w|
STEADY = 2.0  # rad, at which c is measured: of every order above round-off; a gyration in a step that is resolved
LOW, LONGER = 4, 4.0  # orders whose first steps are longer than by the estimate, and how much
DECAYS, GONE = 4e20, 1e19  # of a mode in a run: behind more of them, round-off of damping is larger than the motion
BALANCED = 1e16  # decays in a step that has left a velocity behind: round-off of more is larger than the momentum
CREEPING = 1e-6  # tolerance of the step that is proposed beyond these
PHASE = 0.2  # rad, of a swing in a step that is shown
MANY = 20_000  # steps after which it is no oscillation that runs miss


class First(NamedTuple):
    """What the local estimate chooses: the coarse run to begin with."""

    scheme: Integrator
    pace: Piecewise
    steps: Piecewise
    grid: Segments
    swing: float  # rad/s, about the fastest rate of swings


def first_step(plan: Plan, begin: Starts, pace: Piecewise, swing: float) -> tuple[Integrator, Piecewise]:
    """Return the integrator of the cheapest order, and its steps, by the local estimate; `pace`: |w|."""
    span, lengths, fastest = plan.t_end - plan.t_start, pace.lengths(plan.t_end), np.maximum(pace.values, 1e-300)
    rates = np.maximum(HARMONICS * pace.values, max(swing, 1e-3 / span))
    if not plan.scheme.is_a_stable:
        rates = np.maximum(rates, plan.decay(begin))

    def steps(scheme: Integrator, rates: Array, longer: float = 1.0) -> Array:
        h = _resolving(plan, scheme, float(lengths @ rates)) / rates
        return np.minimum(np.minimum(longer * h, scheme.largest_turn / fastest), span / 2)

    longest = apart_shown(plan, pace, swing).values if plan.is_shown else np.inf
    gyration = gyration_rate(plan.systems, plan.load, plan.t_start, plan.t_end)
    waves = np.maximum(rates, max(2 * pi * highest_frequency(plan.load), gyration))  # low orders need many steps
    shares = lengths / span

    def cost(scheme: Integrator) -> float:
        decays = 0.0 if len(lengths) == 1 else np.log2(span * plan.decay(begin)) / _resolving(plan, scheme, 1.0) / span
        return float(shares @ (scheme.effort / np.minimum(steps(scheme, waves), longest)) + scheme.effort * decays)

    best = min(plan.schemes, key=cost)
    found = steps(best, rates, LONGER if order_of(best) <= LOW else 1.0)
    return best, pace._replace(values=np.minimum(found, longest))


def _resolving(plan: Plan, scheme: Integrator, whole: float) -> float:
    """Return the turn in a step with which a turn by `whole`, rad, is off by a tenth of the tolerance."""
    goal = max(plan.goal, EPS)  # less is refused after a run
    return float((TENTH * goal / (_lag_constant(scheme) * whole)) ** (1 / order_of(scheme)))


@lru_cache(maxsize=64)
def _lag_constant(scheme: Integrator) -> float:
    """Return c, where a step misses a steady turn by θ by c θ^(p + 1)."""
    return float(max(scheme.lag(STEADY), EPS) / STEADY ** (order_of(scheme) + 1))


def apart_shown(plan: Plan, pace: Piecewise, swing: float) -> Piecewise:
    """Return how far states are apart from which figures are made, s: they show a gyration, too, where they can."""
    span = plan.t_end - plan.t_start
    apart = np.minimum(TURN / np.maximum(pace.values, 1e-300), min(span / FEWEST, PHASE / max(swing, 1e-300)))
    gyration = gyration_rate(plan.systems, plan.load, plan.t_start, plan.t_end)
    return pace._replace(values=np.minimum(apart, max(PHASE / max(gyration, 1e-300), span / MANY)))


def first_run(plan: Plan, begin: Starts, fastest: float | None = None) -> First:
    """Return what a run or an ensemble begins with; `fastest`: |w|, if known."""
    fastest, plan = plan.fastest(begin) if fastest is None else fastest, plan.linearised(begin)
    swing, pace = swing_rate(plan.systems, plan.load, begin.load_scale), plan.pace(begin, fastest)
    scheme, h = first_step(plan, begin, pace, swing)
    return First(scheme, pace, h, coarse_grid(plan, begin, scheme, h), swing)


def coarse_grid(plan: Plan, begin: Starts, scheme: Integrator, longest: Piecewise) -> Segments:
    """Return the grid of a coarse run; a higher order resolves more of the load in a step."""
    higher, steps = 1 if plan.is_shown else HIGHER, float(np.sum(longest.lengths(plan.t_end) / longest.values))
    rate, part = plan.decay(begin), 1.0
    if scheme.is_a_stable and rate * (plan.t_end - plan.t_start) > _decays(begin):
        raise ValueError(_too_fast(plan, begin, rate))
    if plan.tolerance is not None and not steps <= MOST:
        raise ValueError(
            f"tolerance = {plan.goal:g} would take about {steps:.1g} steps, and at most {MOST:.0e} are taken: ask for "
            f"less, or choose {damped_steps(plan, begin) or 'an integrator of higher order'}"
        )
    if scheme.is_a_stable:
        part = min(_resolving(plan, scheme, 1.0), 1.0)
        if rate > 0 and begin.velocity.any():
            longest = longest._replace(values=np.minimum(longest.values, BALANCED / rate))
    return segments_of(plan.grid_load, plan.t_start, plan.t_end, longest, True, higher, decay=rate, part=part)


def _decays(begin: Starts) -> float:
    """Return how many decays of a mode a run resolves."""
    return GONE if begin.velocity.any() else DECAYS


def _too_fast(plan: Plan, begin: Starts, rate: float) -> str:
    decays = rate * (plan.t_end - plan.t_start)
    return (
        f"damping slows the body down at a rate of up to {rate:.2g} 1/s: that is {decays:.1g} decays in the run, of "
        f"which at most {_decays(begin):.0e} are resolved; use {_creeping_steps(plan, begin, rate)}"
    )


def _creeping_steps(plan: Plan, begin: Starts, rate: float) -> str:
    """Return up to which time a run resolves decays, and the step of one that follows the motion they leave.

    It begins at rest, if the velocity of the start turns the body by no more than is seen. Steps of the midpoint rule
    turn it by their mean velocity, which is right however long they are; the velocities at nodes are to and fro.
    """
    text = f"t_end <= {plan.t_start + 0.9 * _decays(begin) / rate:.2g} s"
    fastest, linear = plan.fastest(begin), plan.linearised(begin)
    slowest = slowest_damping(plan.systems, linear.load, begin.load_scale).min()
    left = steady(plan.t_start, float(linear.pace(begin, fastest).values[-1]))
    off = fastest / max(slowest, 1e-300) if begin.velocity.any() else 0.0
    own = linear._replace(scheme=LieMidpoint(), schemes=(LieMidpoint(),), tolerance=CREEPING)
    swing = swing_rate(plan.systems, linear.load, begin.load_scale)
    h = even_step(first_step(own, begin, left, swing)[1].largest, plan.grid_load, plan.t_start, plan.t_end)
    if h is None or (plan.t_end - plan.t_start) / h > MOST or off > CREEPING:
        return text
    return (
        f"{text}, or{', from rest,' if off else ''} the integrator lie-midpoint with step = {h:.12g} s, which finds "
        f"the attitude to about {CREEPING:g} rad, but no angular velocity"
    )


def damped_steps(plan: Plan, begin: Starts) -> str:
    """Return what to choose where damped modes must be resolved: what takes them in long steps, and these; or ""."""
    rate = plan.decay(begin)
    if not rate > 0 or plan.scheme.automatic is not None:
        return ""
    own = plan._replace(scheme=Gauss(), schemes=candidates(Gauss(), True), grid=None, output_times=None)
    if rate * (plan.t_end - plan.t_start) > _decays(begin):
        return f"the integrator gauss with {_creeping_steps(own, begin, rate)}"
    try:
        grid = finer(first_run(own.of_steps, begin).grid)
    except ValueError:
        return ""
    return f"the integrator gauss without step=, which takes about {grid.steps} steps of up to {grid.longest:.1g} s"


@lru_cache(maxsize=64)
def finer(grid: Segments) -> Segments:
    """Return a grid with at least 3/2 as many steps in each segment."""
    counts = np.diff(grid.numbers)
    return segmented(grid.borders, np.where(counts % 2 == 0, counts // 2 * 3, 2 * counts))


def expected_grid(plan: Plan, first: First) -> Segments:
    """Return the grid with which a run to a tolerance ends, about: it resolves a gyration, as if that were excited."""
    grid, more = finer(first.grid), steps_of_gyration(plan, first.scheme) / first.grid.steps
    return segmented(grid.borders, np.ceil(np.diff(grid.numbers) * max(more, 1.0)))


def steps_of_gyration(plan: Plan, scheme: Integrator) -> float:
    """Return how many steps resolve the gyration that rotors and wheels cause; 0 without."""
    rate = gyration_rate(plan.systems, plan.load, plan.t_start, plan.t_end)
    whole = (plan.t_end - plan.t_start) * rate
    return whole / _resolving(plan, scheme, whole) if whole else 0.0


def order_of(scheme: Integrator) -> float:
    """Return the order of the steps of an integrator."""
    return float(getattr(scheme, "order", 2))
