"""A path on the sphere taken sample by sample: the frame at its end, and how far that may be off.

`frames` derives the frames and the estimate. The state of a path is a `Path`, zeros at the start. What is needed of the
past are four nodes, four chords, three curvatures and one second derivative of the curvature; so the memory and the
time of a sample do not grow. `frame_kernels` has the formulas that whole arrays share with this.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, logical_not, select, smaller, sqrt
from ..kernels.kernel import kernel, part
from ..kernels.memory import View, size_of, vector_at, view_in
from ..kernels.vectors import Vector
from .frame_kernels import ANTIPODAL, NO_CHORD, SHORT, curvature, inner_roll, length, outer_roll, transported


class Path(NamedTuple):
    """Where a path is.

    Attributes
    ----------
    samples, nodes : float
        Numbers of samples and nodes.
    run, whole : float
        Length of the path since the last node, and of all of it.
    last, first : Vector
        The last sample and the first.
    n0, n1, n2, n3 : Vector
        The last four nodes, the newest last.
    chords, kappas : tuple
        The last four chords and the last three curvatures.
    second : float
        The last second derivative of the curvature.
    start, settled, newest : Vector
        d1 at the first node, at the last but one and at the last.
    rolls, roll, roll_squares, roll_most : float
        Sum of the rolls up to the last node but one, the next one, the sum of the squares, the largest sum.
    error, error_squares, error_most : float
        The same of the errors of the rolls.
    """

    samples: float
    nodes: float
    run: float
    last: Vector
    n0: Vector
    n1: Vector
    n2: Vector
    n3: Vector
    chords: Annotated[tuple[Any, ...], 4]
    kappas: Annotated[tuple[Any, ...], 3]
    second: float
    start: Vector
    settled: Vector
    newest: Vector
    rolls: float
    roll: float
    roll_squares: float
    roll_most: float
    error: float
    error_squares: float
    error_most: float
    whole: float
    first: Vector


SIZE = size_of(Path)
ANTIPODAL_DISTANCE = math.sqrt(ANTIPODAL)
_EPS = 2.0**-52
MOST = 0.125  # of the square of an arc: half the square over its half, which no path as short leaves
_RESOLVED = 5  # nodes from which the curvature has a second derivative


def begin(s: View, u: Vector, d1: Vector) -> None:
    """Let the path of the state begin at a point, with this d1."""
    s.samples, s.nodes = 1.0, 1.0
    s.last = s.n3 = s.first = u
    s.start = s.settled = s.newest = d1


def is_antipodal(s: View, u: Vector) -> Any:
    """Whether a point is the antipode of the last sample or of the last node."""
    return (length(u + s.last) < ANTIPODAL_DISTANCE) | (length(u + s.n3) < ANTIPODAL_DISTANCE)


def add_sample(s: View, u: Vector) -> Any:
    """Take the path to its next sample, no antipode of the last one or of the last node; whether it is a node."""
    v = Variables(here=0.0, is_node=False)
    step, whole = length(u - s.last), s.whole
    s.samples, s.run, s.whole, s.last = s.samples + 1.0, s.run + step, whole + step, u
    for _ in when(s.run > SHORT * s.chords[3]):
        v.here = length(u - s.n3)
        for _ in when(v.here > NO_CHORD):
            v.is_node = True
            for _ in when(whole <= SHORT * step):  # all so far was a stay at the start
                s.nodes, s.error, s.error_squares, s.error_most = 1.0, 0.0, 0.0, 0.0
                s.n3 = s.first
                v.here = length(u - s.first)
            s.run, s.nodes = 0.0, s.nodes + 1.0
            s.n0, s.n1, s.n2, s.n3 = s.n1, s.n2, s.n3, u
            s.chords = (*s.chords[1:], v.here)
            for _ in when(s.nodes > 2.0):
                s.kappas = (*s.kappas[1:], curvature(s.n1, s.n2, s.n3, s.chords[2], s.chords[3]))
            _settle(s)
            for _ in when(s.nodes >= _RESOLVED):
                _settle_errors(s)
    return v.is_node


def _settle(s: View) -> None:
    """Carry d1 to the last node but one, whose segment has curvatures at both ends now, and on to the last one.

    Up to four nodes the first segment changes with each node: all is done anew.
    """
    count, (_, c1, c2, c3), (_, k1, k2) = s.nodes, s.chords, s.kappas
    for _ in when(count <= 4.0):
        s.rolls, s.roll_squares, s.roll_most, s.settled = 0.0, 0.0, 0.0, s.start
        for _ in when(count == 3.0):
            _roll_on(s, s.n1, s.n2, outer_roll(c2, c3, c3, k2, k2))
        for _ in when(count == 4.0):
            _roll_on(s, s.n0, s.n1, outer_roll(c1, c2, c3, k1, k2))
    s.roll = 0.0
    for _ in when(count == 3.0):
        s.roll = outer_roll(c3, c2, c2, k2, k2)
    for _ in when(count >= 4.0):
        _roll_on(s, s.n1, s.n2, inner_roll(c2, c1, c3, k1, k2))
        s.roll = outer_roll(c3, c2, c1, k2, k1)
    s.newest = transported(s.settled, s.n2, s.n3, s.roll)


def _roll_on(s: View, a: Vector, b: Vector, roll: Any) -> None:
    """Carry d1 that is settled from one node to the next."""
    s.settled = transported(s.settled, a, b, roll)
    s.rolls, s.roll_squares = s.rolls + roll, s.roll_squares + roll * roll
    s.roll_most = larger(s.roll_most, abs(s.rolls))


def _arc(chord: Any) -> Any:
    return chord + chord * chord * chord / 24.0


def _without_cube(k: Any, a: Any, b: Any) -> Any:
    """Return the curvature of three points with the arcs a and b, less what comes from the cube of the curvature."""
    return k + a * b / 8.0 * (k * k * k + k)


def _bend(x: Any, a: Any, b: Any) -> Any:
    """Return what a second derivative of 1 at 0 adds to the curvature of three points about x, arcs a and b apart."""
    return 0.5 * x * x + x * (b - a) / 3.0 + (a * a - a * b + b * b) / 12.0


def _second_derivative(s: View) -> Any:
    """Return the second derivative of the curvature at the last node but two, from five nodes."""
    (g0, g1, g2, g3), (k0, k1, k2) = map(_arc, s.chords), s.kappas
    before, after = (g0 + g1 + g2) / 3.0, (g1 + g2 + g3) / 3.0  # distances of the centroids
    k0, k1, k2 = _without_cube(k0, g0, g1), _without_cube(k1, g1, g2), _without_cube(k2, g2, g3)
    z0, z1, z2 = _bend(-g1, g0, g1), _bend(0.0, g1, g2), _bend(g2, g2, g3)
    return ((k2 - k1) / after - (k1 - k0) / before) / ((z2 - z1) / after - (z1 - z0) / before)


@part
def _error(h: Any, a: Any, ka: Any, xa: Any, lead: Any, kb: Any, xb: Any, b: Any, second: Any) -> Any:
    """Return the error of the roll of a segment of arc h whose curvature comes from nodes at xa and xb from its middle.

    Where samples do not resolve the curvature, as at corners that rounding makes, it is an area beside the arc at most.

    Node a has the arcs a and `lead` beside it, node b `lead` and b. Where one is short, one curvature was used, or
    none.
    """
    ca, cb, h3 = xa + (lead - a) / 3.0, xb + (b - lead) / 3.0, h * h * h
    wb = -ca / (cb - ca)
    wa = 1.0 - wb
    is_used = (larger(a, b) >= SHORT * h) & (lead >= SHORT * h)
    used = select(is_used, select(b < a, ka, kb), 0.0)
    bend = wa * _bend(xa, a, lead) + wb * _bend(xb, lead, b)
    k = wa * _without_cube(ka, a, lead) + wb * _without_cube(kb, lead, b) - second * bend
    cube = k * k * k + k
    full = h3 / 12.0 * (second * bend - cube * (wa * a * lead + wb * lead * b) / 8.0)
    full = full + h3 * h * h * ((2.0 * (cube - 3.0 * k) - second) / 480.0 - cube / 96.0)
    found = select(smaller(a, smaller(lead, b)) < SHORT * h, h3 / 12.0 * (used - wa * ka - wb * kb), full)
    return larger(-MOST * h * h, smaller(MOST * h * h, found))


def _add_error(s: View, error: Any) -> None:
    s.error, s.error_squares = s.error + error, s.error_squares + error * error
    s.error_most = larger(s.error_most, abs(s.error))


def _settle_errors(s: View) -> None:
    """Add the error of the last segment but two, which has second derivatives at both ends now."""
    second, (g0, g1, g2, _), (k0, k1, _) = _second_derivative(s), map(_arc, s.chords), s.kappas
    is_first = s.nodes == _RESOLVED
    for _ in when(is_first):
        _add_error(s, _error(g0, g0, k0, 0.5 * g0, g1, k1, 0.5 * g0 + g1, g2, second))
    both = select(logical_not(is_first) & (abs(s.second) < abs(second)), s.second, second)
    _add_error(s, _error(g1, g0, k0, -0.5 * g1, g1, k1, 0.5 * g1, g2, both))
    s.second = second


def estimate(s: View, order: Any) -> Any:
    """Return the estimated largest error angle so far of the frames of this order."""
    rolls, has_errors = s.rolls + s.roll, s.nodes >= _RESOLVED
    v = Variables(squares=s.roll_squares + s.roll * s.roll, most=larger(s.roll_most, abs(rolls)))
    for _ in when(has_errors):  # else the rolls stand for their errors
        (_, g1, g2, g3), (_, k1, k2), second = map(_arc, s.chords), s.kappas, s.second
        inner = _error(g2, g1, k1, -0.5 * g2, g2, k2, 0.5 * g2, g3, second)
        outer = _error(g3, g1, k1, -0.5 * g3 - g2, g2, k2, -0.5 * g3, g3, second)
        one = s.error + inner
        v.squares = s.error_squares + inner * inner + outer * outer
        v.most = larger(larger(s.error_most, abs(one)), abs(one + outer))
    found = 2.0 * sqrt(v.most * v.most + v.squares)
    found = found + select(order == 2, larger(s.roll_most, abs(rolls)), 0.0)
    return found + _EPS * (10.0 + 0.02 * s.samples)


@kernel("f8[:, :, :], i8, f8[:], f8[:, :]")
def error_angles(u: Any, order: Any, state: Any, bound: Any) -> None:
    """Set ``bound[k, i]``, the estimate at sample i of the path ``u[k]`` from the samples up to there.

    It is infinite before the last sample where these are too few. Working space: `state` (SIZE,).
    """
    s, zero = view_in(Path, state), Vector(0.0, 0.0, 0.0)
    for k in loop(u.shape[0]):
        for i in loop(SIZE):
            state[i] = 0.0
        begin(s, vector_at(u[k, 0]), zero)
        for i in loop(u.shape[1]):
            x = vector_at(u[k, i])
            for _ in when(i > 0):
                for _ in when(logical_not(is_antipodal(s, x))):
                    add_sample(s, x)
            is_known = (s.nodes >= _RESOLVED) | (i == u.shape[1] - 1)
            bound[k, i] = select(is_known, estimate(s, order), math.inf)
