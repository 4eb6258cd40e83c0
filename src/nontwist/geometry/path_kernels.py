"""A path on the sphere taken sample by sample: its frame, how far that may be off, and the twist of a body about it.

`frames` derives the frames and the estimate. The state of a path is a `Path`, zeros at the start. What is needed of the
past are four nodes, four chords, three curvatures and one second derivative of the curvature; so the memory and the
time of a sample do not grow. `frame_kernels` has the formulas that whole arrays share with this.

Twist is that of quaternions: of all samples at once, and sample by sample for any number of streams, with the same
bits. A stream has a `Stream`, zeros at the start: its path, and what follows.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..kernels.control import Variables, loop, when
from ..kernels.elements import arctan2, floor, larger, logical_not, select, smaller, sqrt
from ..kernels.kernel import kernel, part
from ..kernels.memory import View, matrix_at, put, scratch, size_of, vector_at, view_in
from ..kernels.vectors import Matrix, Quaternion, Vector, cross
from .arrays import Array
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


ANTIPODAL_DISTANCE = math.sqrt(ANTIPODAL)
_EPS = 2.0**-52
MOST = 0.125  # of the square of an arc: half the square over its half, which no path as short leaves
_RESOLVED = 5  # nodes from which the curvature has a second derivative


def begin(s: View, u: Vector, d1: Vector) -> None:
    """Let the path of the state begin at a point, with this d1."""
    for i in loop(size_of(Path)):
        s.set_number(i, 0.0)
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


@kernel("f8[:, :, :], i8, f8[:, :]")
def error_angles(u: Any, order: Any, bound: Any) -> None:
    """Set ``bound[k, i]``, the estimate at sample i of the path ``u[k]`` from the samples up to there.

    It is infinite before the last sample where these are too few.
    """
    s, zero = View(Path, scratch(size_of(Path))), Vector(0.0, 0.0, 0.0)
    for k in loop(u.shape[0]):
        begin(s, vector_at(u[k, 0]), zero)
        for i in loop(u.shape[1]):
            x = vector_at(u[k, i])
            for _ in when(i > 0):
                for _ in when(logical_not(is_antipodal(s, x))):
                    add_sample(s, x)
            is_known = (s.nodes >= _RESOLVED) | (i == u.shape[1] - 1)
            bound[k, i] = select(is_known, estimate(s, order), math.inf)


class Stream(NamedTuple):
    """A stream of quaternions.

    Attributes
    ----------
    path : Path
        The path of d3.
    great : Vector
        d1 carried along great circles.
    quaternion, body, d3, time : Quaternion, Vector, Vector, float
        Those of the last sample, scalar last; d1 of the body.
    is_node : float
        Whether the last sample was a node.
    speed : float
        Its speed, rad a unit of time.
    base, twist, before : float
        Angle at the start, twist now, twist one sample ago.
    flags : float
        Steps that were flagged.
    """

    path: Path
    great: Vector
    quaternion: Quaternion
    body: Vector
    d3: Vector
    time: float
    is_node: float
    speed: float
    base: float
    twist: float
    before: float
    flags: float


SIZE = size_of(Stream)
_HALF_TURN = math.pi * (1.0 - 1e-9)
_TURN = 2.0 * math.pi


def _first_and_third(q: Any, sign: Any, triad: Matrix) -> tuple[Vector, Vector]:
    """Return the first and the third vector of a triad in the body; `sign` is -1 for the inverse of the attitude."""
    x, y, z, w = q
    size = sqrt(x * x + y * y + z * z + w * w)
    turn = Quaternion(w / size, sign * x / size, sign * y / size, sign * z / size)
    d3 = turn.rotate(triad[2])
    return turn.rotate(triad[0]), d3 / length(d3)


def _angle(t: Vector, d: Vector, v: Vector) -> Any:
    """Return the angle about d from v to t."""
    return arctan2(t @ cross(d, v), t @ v)


def _nearest(angle: Any, last: Any) -> Any:
    """Return the angle, plus whole turns, that is nearest to the last one."""
    return angle + _TURN * floor((last - angle) / _TURN + 0.5)


def body_axes(quaternions: Array, sign: float, triad: Array) -> tuple[Array, Array]:
    """Return the first and the third vector of a triad that is fixed in the body, for quaternions, scalar last."""
    first, d3 = _first_and_third(tuple(quaternions.T), sign, matrix_at(triad))
    return np.stack(first, axis=-1), np.stack(d3, axis=-1)


@kernel("f8[:, :], f8[:, :, :], f8[:]")
def angles(first: Any, frames: Any, psi: Any) -> None:
    """Set the angle from the frames to the vectors `first`, in whole turns as well, 0 at the start."""
    v = Variables(base=0.0, last=0.0)
    for i in loop(first.shape[0]):
        angle = _angle(vector_at(first[i]), vector_at(frames[i, 2]), vector_at(frames[i, 0]))
        for _ in when(i == 0):
            v.base = angle
        v.last = _nearest(angle - v.base, v.last)
        psi[i] = v.last


def _square(q: Any) -> Any:
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]


def _is_given(q: Any) -> Any:
    return (_square(q) > 0.0) & (_square(q) < math.inf)


@kernel("f8[:, :], f8[:, :], f8[:], i8, f8, f8[:, :], f8, f8[:, :] -> i8, i8")
def count(
    state: Any, given: Any, time: Any, order: Any, sign: Any, triad: Any, tolerance: Any, found: Any
) -> tuple[Any, Any]:
    """Take each stream to its next sample; set twist, error, twist of the sample before and flags in `found`.

    A stream without a sample, not finite or zero, stays as it is. What is wrong and the stream: 1 a quaternion that is
    not of length 1 within `tolerance`, 2 a time that does not increase; 0 and -1 where nothing is, else no stream has
    moved.
    """
    wrong = Variables(what=0, k=-1)
    for k in loop(state.shape[0], whilst=lambda: wrong.what == 0):
        s, at = view_in(Stream, state[k]), select(time.shape[0] == 1, 0, k)
        for _ in when(_is_given(given[k])):
            is_late = (s.path.samples > 0.0) & logical_not(time[at] > s.time)
            for _ in when(is_late):
                wrong.what, wrong.k = 2, k
            for _ in when(logical_not(abs(sqrt(_square(given[k])) - 1.0) <= tolerance)):
                wrong.what, wrong.k = 1, k
    for k in loop(select(wrong.what == 0, state.shape[0], 0)):
        s, at = view_in(Stream, state[k]), select(time.shape[0] == 1, 0, k)
        for _ in when(_is_given(given[k])):
            q = Quaternion(*(given[k, j] for j in range(4)))
            d1, d3 = _first_and_third(q, sign, matrix_at(triad))
            is_first = s.path.samples == 0.0
            for _ in when(is_first):
                _start(s, d1, d3)
            for _ in when(logical_not(is_first)):
                _flag(s, q, time[at])
                _move(s, order, d1, d3)
            s.body, s.d3, s.time, s.quaternion = d1, d3, time[at], q
        is_begun = s.path.samples > 0.0
        error = select(is_begun, estimate(s.path, order), 0.0)
        put(found[k], (sign * s.twist, error, sign * s.before, s.flags))
    return wrong.what, wrong.k


@part
def _start(s: View, d1: Vector, d3: Vector) -> None:
    """Begin the path of a stream."""
    v = transported(d1, d3, d3, 0.0 * d3[0])
    begin(s.path, d3, v)
    s.great, s.base, s.is_node = v, _angle(d1, d3, v), 1.0


def _flag(s: View, q: Quaternion, time: Any) -> None:
    """Flag a step in which the body turned by half a turn, or at its speed would have turned by more."""
    p = s.quaternion
    dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    rest = _square(p) * _square(q) - dot * dot
    turn, span = 2.0 * arctan2(sqrt(larger(rest, 0.0)), abs(dot)), time - s.time
    is_far = larger(turn, s.speed * span) >= _HALF_TURN
    s.flags, s.speed = s.flags + select(is_far, 1.0, 0.0), select(is_far, s.speed, turn / span)


def _move(s: View, order: Any, d1: Vector, d3: Vector) -> None:
    """Take a stream to its next sample."""
    is_opposite = is_antipodal(s.path, d3)
    for _ in when(is_opposite):
        s.flags = larger(s.flags, 1.0)  # which `_flag` has counted, up to round-off
        _start_again(s, d1, d3)
    for _ in when(logical_not(is_opposite)):
        none = 0.0 * d3[0]
        s.great = transported(s.great, s.path.last, d3, none)
        is_node = add_sample(s.path, d3)
        v = Variables(d1=s.great)
        earlier = s.before
        s.before = s.twist
        for _ in when(is_node & (order == 4)):
            settled = _settled_twist(s, earlier)
            s.before, s.twist = settled, settled
            v.d1 = s.path.newest
        for _ in when(logical_not(is_node) & (order == 4)):
            v.d1 = transported(s.path.newest, s.path.n3, d3, none)
        s.is_node = select(is_node, 1.0, 0.0)
        s.twist = _nearest(_angle(d1, d3, v.d1) - s.base, s.twist)


def _settled_twist(s: View, earlier: Any) -> Any:
    """Return the twist of the last sample, with the frame that has settled, counted on from that of one earlier."""
    v = Variables(d1=s.path.settled)
    for _ in when(s.is_node == 0.0):
        v.d1 = transported(v.d1, s.path.n2, s.d3, 0.0 * s.time)
    return _nearest(_angle(s.body, s.d3, v.d1) - s.base, earlier)


def _start_again(s: View, d1: Vector, d3: Vector) -> None:
    """Begin a new path where the axis has turned by half a turn, with the twist so far."""
    _start(s, d1, d3)
    s.before, s.base = s.twist, s.base - s.twist
