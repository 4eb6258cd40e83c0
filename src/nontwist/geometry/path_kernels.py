"""A path on the sphere taken sample by sample: the frame at its end, and how far that may be off.

`frames` derives the frames and the estimate. The state of a path is a row of `SIZE` numbers, zeros at the start. What
is needed of the past are four nodes, four chords, three curvatures and one second derivative of the curvature; so the
memory and the time of a sample do not grow. `frame_kernels` has the formulas that whole arrays share with this.
"""

from __future__ import annotations

import math

from .arrays import Array
from .compiled import kernel, shared
from .frame_kernels import ANTIPODAL, NO_CHORD, SHORT, carried, curvature, distance, inner_roll, outer_roll

# Places of a row: how many samples and nodes; path since the last node; the last sample; the last four nodes, four
# chords, three curvatures and one second derivative, the newest last; d1 at the first node, at the last but one and at
# the last; rolls up to the last but one, the next, their squares, the largest sum; the same of the errors; length
# of the path; its first point.
SAMPLES, COUNT, RUN, LAST, NODES, CHORDS, KAPPAS, SECOND = 0, 1, 2, 3, 6, 18, 22, 25
START, SETTLED, NEWEST, ROLLS, ROLL, ROLL_SQUARES, ROLL_MOST = 26, 29, 32, 35, 36, 37, 38
ERROR, ERROR_SQUARES, ERROR_MOST, WHOLE, FIRST, SIZE = 39, 40, 41, 42, 43, 46
ANTIPODAL_DISTANCE = math.sqrt(ANTIPODAL)
_EPS = 2.0**-52
_BENT = 5  # nodes from which the curvature has a second derivative


@shared
def begin(s: Array, x: float, y: float, z: float, vx: float, vy: float, vz: float) -> None:
    """Let the path of the state begin at a point, with this d1."""
    s[SAMPLES], s[COUNT] = 1.0, 1.0
    s[LAST], s[LAST + 1], s[LAST + 2] = x, y, z
    s[NODES + 9], s[NODES + 10], s[NODES + 11] = x, y, z
    s[FIRST], s[FIRST + 1], s[FIRST + 2] = x, y, z
    for place in (START, SETTLED, NEWEST):
        s[place], s[place + 1], s[place + 2] = vx, vy, vz


@shared
def is_antipodal(s: Array, x: float, y: float, z: float) -> bool:
    """Whether a point is the antipode of the last sample or of the last node."""
    for last in (LAST, NODES + 9):
        if distance(-s[last], -s[last + 1], -s[last + 2], x, y, z) < ANTIPODAL_DISTANCE:
            return True
    return False


@shared
def advance(s: Array, x: float, y: float, z: float) -> bool:
    """Take the path to its next sample, no antipode of the last one or of the last node; whether it is a node."""
    s[SAMPLES] += 1.0
    step, whole = distance(s[LAST], s[LAST + 1], s[LAST + 2], x, y, z), s[WHOLE]
    s[RUN] += step
    s[WHOLE] += step
    s[LAST], s[LAST + 1], s[LAST + 2] = x, y, z
    if not s[RUN] > SHORT * s[CHORDS + 3]:
        return False
    here = distance(s[NODES + 9], s[NODES + 10], s[NODES + 11], x, y, z)
    if not here > NO_CHORD:
        return False
    if whole <= SHORT * step:  # all so far was a stay at the start
        s[COUNT], s[ERROR], s[ERROR_SQUARES], s[ERROR_MOST] = 1.0, 0.0, 0.0, 0.0
        s[NODES + 9], s[NODES + 10], s[NODES + 11] = s[FIRST], s[FIRST + 1], s[FIRST + 2]
        here = distance(s[FIRST], s[FIRST + 1], s[FIRST + 2], x, y, z)
    s[RUN] = 0.0
    s[COUNT] += 1.0
    for i in range(9):
        s[NODES + i] = s[NODES + 3 + i]
    s[NODES + 9], s[NODES + 10], s[NODES + 11] = x, y, z
    for i in range(3):
        s[CHORDS + i] = s[CHORDS + 1 + i]
    s[CHORDS + 3] = here
    if s[COUNT] > 2.0:
        s[KAPPAS], s[KAPPAS + 1] = s[KAPPAS + 1], s[KAPPAS + 2]
        s[KAPPAS + 2] = _last_curvature(s)
    _settle(s)
    if s[COUNT] >= _BENT:
        _settle_errors(s)
    return True


@shared
def _last_curvature(s: Array) -> float:
    return curvature(
        s[NODES + 3],
        s[NODES + 4],
        s[NODES + 5],
        s[NODES + 6],
        s[NODES + 7],
        s[NODES + 8],
        s[NODES + 9],
        s[NODES + 10],
        s[NODES + 11],
        s[CHORDS + 2],
        s[CHORDS + 3],
    )


@shared
def _settle(s: Array) -> None:
    """Carry d1 to the last node but one, whose segment has curvatures at both ends now, and on to the last one.

    Up to four nodes the first segment changes with each node: all is done anew.
    """
    count, c, k = s[COUNT], CHORDS, KAPPAS
    if count <= 4.0:
        s[ROLLS], s[ROLL_SQUARES], s[ROLL_MOST] = 0.0, 0.0, 0.0
        s[SETTLED], s[SETTLED + 1], s[SETTLED + 2] = s[START], s[START + 1], s[START + 2]
        if count == 3.0:
            _roll_on(s, NODES + 3, outer_roll(s[c + 2], s[c + 3], 0.0, s[k + 2], 0.0))
        elif count == 4.0:
            _roll_on(s, NODES, outer_roll(s[c + 1], s[c + 2], s[c + 3], s[k + 1], s[k + 2]))
    if count >= 4.0:
        _roll_on(s, NODES + 3, inner_roll(s[c + 2], s[c + 1], s[c + 3], s[k + 1], s[k + 2]))
    s[ROLL] = 0.0
    if count == 3.0:
        s[ROLL] = outer_roll(s[c + 3], s[c + 2], 0.0, s[k + 2], 0.0)
    elif count >= 4.0:
        s[ROLL] = outer_roll(s[c + 3], s[c + 2], s[c + 1], s[k + 2], s[k + 1])
    s[NEWEST], s[NEWEST + 1], s[NEWEST + 2] = _along(s, SETTLED, NODES + 6, s[ROLL])


@shared
def _roll_on(s: Array, node: int, roll: float) -> None:
    """Carry d1 that is settled from the node at a place to the next one."""
    s[SETTLED], s[SETTLED + 1], s[SETTLED + 2] = _along(s, SETTLED, node, roll)
    s[ROLLS] += roll
    s[ROLL_SQUARES] += roll * roll
    s[ROLL_MOST] = max(s[ROLL_MOST], abs(s[ROLLS]))


@shared
def _along(s: Array, d1: int, node: int, roll: float) -> tuple[float, float, float]:
    return carried(
        s[d1],
        s[d1 + 1],
        s[d1 + 2],
        s[node],
        s[node + 1],
        s[node + 2],
        s[node + 3],
        s[node + 4],
        s[node + 5],
        roll,
    )


@shared
def _arc(chord: float) -> float:
    return chord + chord * chord * chord / 24.0


@shared
def _plain(k: float, a: float, b: float) -> float:
    """Curvature of three points with the arcs a and b, less the part that comes from the cube of the curvature."""
    return k + a * b / 8.0 * (k * k * k + k)


@shared
def _bend(x: float, a: float, b: float) -> float:
    """Return what a second derivative of 1 at 0 adds to the curvature of three points about x, arcs a and b apart."""
    return 0.5 * x * x + x * (b - a) / 3.0 + (a * a - a * b + b * b) / 12.0


@shared
def _second_derivative(s: Array) -> float:
    """Second derivative of the curvature at the last node but two, from five nodes."""
    g0, g1, g2, g3 = _arc(s[CHORDS]), _arc(s[CHORDS + 1]), _arc(s[CHORDS + 2]), _arc(s[CHORDS + 3])
    before, after = (g0 + g1 + g2) / 3.0, (g1 + g2 + g3) / 3.0  # distances of the centroids
    k0, k1, k2 = _plain(s[KAPPAS], g0, g1), _plain(s[KAPPAS + 1], g1, g2), _plain(s[KAPPAS + 2], g2, g3)
    z0, z1, z2 = _bend(-g1, g0, g1), _bend(0.0, g1, g2), _bend(g2, g2, g3)
    return ((k2 - k1) / after - (k1 - k0) / before) / ((z2 - z1) / after - (z1 - z0) / before)


@shared
def _error(
    h: float, a: float, ka: float, xa: float, lead: float, kb: float, xb: float, b: float, second: float
) -> float:
    """Error of the roll of a segment of arc h whose curvature comes from nodes at xa and xb, seen from its middle.

    Node a has the arcs a and `lead` beside it, node b `lead` and b.
    """
    ca, cb = xa + (lead - a) / 3.0, xb + (b - lead) / 3.0
    wb = -ca / (cb - ca)
    wa = 1.0 - wb
    if min(a, lead, b) < SHORT * h:  # one curvature was used, or none
        used = 0.0
        if max(a, b) >= SHORT * h and lead >= SHORT * h:
            used = ka if b < a else kb
        return h * h * h / 12.0 * (used - wa * ka - wb * kb)
    bend = wa * _bend(xa, a, lead) + wb * _bend(xb, lead, b)
    k = wa * _plain(ka, a, lead) + wb * _plain(kb, lead, b) - second * bend
    cube = k * k * k + k
    h3 = h * h * h
    return h3 / 12.0 * (second * bend - cube * (wa * a * lead + wb * lead * b) / 8.0) + h3 * h * h * (
        (2.0 * (cube - 3.0 * k) - second) / 480.0 - cube / 96.0
    )


@shared
def _add_error(s: Array, error: float) -> None:
    s[ERROR] += error
    s[ERROR_SQUARES] += error * error
    s[ERROR_MOST] = max(s[ERROR_MOST], abs(s[ERROR]))


@shared
def _settle_errors(s: Array) -> None:
    """Add the error of the last segment but two, which has second derivatives at both ends now."""
    second = _second_derivative(s)
    g0, g1, g2 = _arc(s[CHORDS]), _arc(s[CHORDS + 1]), _arc(s[CHORDS + 2])
    k0, k1 = s[KAPPAS], s[KAPPAS + 1]
    both = second
    if s[COUNT] == _BENT:
        _add_error(s, _error(g0, g0, k0, 0.5 * g0, g1, k1, 0.5 * g0 + g1, g2, second))
    elif abs(s[SECOND]) < abs(second):
        both = s[SECOND]
    _add_error(s, _error(g1, g0, k0, -0.5 * g1, g1, k1, 0.5 * g1, g2, both))
    s[SECOND] = second


@shared
def estimate(s: Array, order: int) -> float:
    """Estimated largest error angle so far of the frames of this order."""
    error, squares, most = s[ERROR], s[ERROR_SQUARES], s[ERROR_MOST]
    rolls = s[ROLLS] + s[ROLL]
    if s[COUNT] < _BENT:  # the rolls stand for their errors
        squares, most = s[ROLL_SQUARES] + s[ROLL] * s[ROLL], max(s[ROLL_MOST], abs(rolls))
    else:
        g1, g2, g3 = _arc(s[CHORDS + 1]), _arc(s[CHORDS + 2]), _arc(s[CHORDS + 3])
        k1, k2, second = s[KAPPAS + 1], s[KAPPAS + 2], s[SECOND]
        for e in (
            _error(g2, g1, k1, -0.5 * g2, g2, k2, 0.5 * g2, g3, second),
            _error(g3, g1, k1, -0.5 * g3 - g2, g2, k2, -0.5 * g3, g3, second),
        ):
            error += e
            squares += e * e
            most = max(most, abs(error))
    found = 2.0 * math.sqrt(most * most + squares)
    if order == 2:
        found += max(s[ROLL_MOST], abs(rolls))
    total: float = found + _EPS * (10.0 + 0.02 * s[SAMPLES])
    return total


@kernel("f8[:, :, :], i8, f8[:], f8[:, :]")
def error_angles(u: Array, order: int, state: Array, bound: Array) -> None:
    """Set ``bound[k, i]``, the estimate at sample i of the path ``u[k]`` from the samples up to there.

    It is infinite before the last sample where these are too few.
    """
    last = u.shape[1] - 1
    for k in range(u.shape[0]):
        for i in range(SIZE):
            state[i] = 0.0
        begin(state, u[k, 0, 0], u[k, 0, 1], u[k, 0, 2], 0.0, 0.0, 0.0)
        for i in range(u.shape[1]):
            x, y, z = u[k, i, 0], u[k, i, 1], u[k, i, 2]
            if i > 0 and not is_antipodal(state, x, y, z):
                advance(state, x, y, z)
            bound[k, i] = estimate(state, order) if state[COUNT] >= _BENT or i == last else math.inf
