"""Compiled loops of the non-twisting frames; `frames` derives them.

Every array has one member axis first: directors ``u`` (m, n, 3), unit vectors; frames (m, n, 3, 3), rows d1, d2, d3.
"""

from __future__ import annotations

import math
from typing import Any

from ..kernels.control import Variables, loop, when
from ..kernels.elements import arctan2, cos, logical_not, select, sin, sqrt
from ..kernels.kernel import kernel, part
from ..kernels.memory import put, vector_at
from ..kernels.vectors import Quaternion, Vector, cross

# A chord below this fraction of its neighbour carries no curvature: noise of the samples divided by the chord.
SHORT = 1e-3
# A chord up to which two samples count as one: the frame is right without it up to 1e-100 rad, and products of several
# such chords and of curvatures, their inverses, would be too small or too large for a float.
NO_CHORD = 1e-50
# Squared length of d_i + d_(i+1) below which the two count as antipodal: 1e-7 rad from it the great circle is noise.
ANTIPODAL = 1e-14
# The same length at a right angle, less round-off.
_RIGHT = 2.0 - 1e-9


def length(v: Any) -> Any:
    """Return the length of a vector."""
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _chord(u: Any, i: Any, j: Any) -> Any:
    return length(vector_at(u[j]) - vector_at(u[i]))


def _choose_nodes(u: Any, n: Any, nodes: Any) -> Any:
    """Choose the samples that carry curvature: all but those whose path since the last one chosen is next to nothing.

    That is none, or at most `SHORT` times the chord before; a chord up to `NO_CHORD` is none. A long rest with small
    motion has a longer path, and is kept. At the start, where there is no chord before, it is the path so far that is
    next to nothing beside a chord after it. Else the choice does not depend on later samples. Returns their number.
    """
    v = Variables(count=1, before=0.0, run=0.0, whole=0.0)
    nodes[0] = 0
    for i in loop(1, n):
        step = _chord(u, i - 1, i)
        v.run = v.run + step
        for _ in when(v.run > SHORT * v.before):
            here = _chord(u, nodes[v.count - 1], i)
            for _ in when(here > NO_CHORD):
                is_first = v.whole <= SHORT * step
                v.count = select(is_first, 1, v.count)
                nodes[v.count] = i
                v.count, v.before, v.run = v.count + 1, select(is_first, _chord(u, 0, i), here), 0.0
        v.whole = v.whole + step
    return v.count


def curvature(a: Vector, b: Vector, c: Vector, l: Any, m: Any) -> Any:
    """Return the geodesic curvature of three points with the chords l and m between them, at their centroid."""
    return 2.0 * (b @ cross(b - a, c - b)) / (l * m * (l + m))


def inner_roll(l: Any, lm: Any, lp: Any, kl: Any, kr: Any) -> Any:
    """Return the roll of a segment of length l between two others, with the curvatures at its ends.

    Of these the one that comes from a much shorter neighbour is not used.
    """
    has_left, has_right = lm >= SHORT * l, lp >= SHORT * l
    both = kl + (lm + 0.5 * l) / (lm + l + lp) * (kr - kl)
    return select(has_left & has_right, both, select(has_right, kr, select(has_left, kl, 0.0))) * l * l * l / 12.0


def outer_roll(l: Any, near: Any, far: Any, k: Any, next_k: Any) -> Any:
    """Return the roll of a segment of length l at an end, extrapolated; of two segments, far is near and k next_k."""
    middle = k - select(far >= SHORT * near, (near + 0.5 * l) / (l + near + far) * (next_k - k), 0.0)
    return select(near >= SHORT * l, middle, 0.0) * l * l * l / 12.0


def _segment_rolls(u: Any, nodes: Any, count: Any, is_closed: Any, lengths: Any, kappa: Any, roll: Any) -> None:
    """Set the roll of each segment of a smooth curve through the nodes against its great circle, ``kappa l^3 / 12``.

    Segment i runs from node i to node i + 1. On a closed curve the last node is the first one again.
    """
    segments = count - 1
    for i in loop(segments):
        lengths[i] = _chord(u, nodes[i], nodes[i + 1])
    for i in loop(select(is_closed, 0, 1), segments):  # kappa[i] belongs to node i
        before = select(i > 0, i - 1, segments - 1)
        a, b, c = (vector_at(u[nodes[j]]) for j in (before, i, i + 1))
        kappa[i] = curvature(a, b, c, lengths[before], lengths[i])
    for i in loop(segments):
        roll[i] = 0.0
        before, after = select(i > 0, i - 1, segments - 1), select(i + 1 < segments, i + 1, 0)
        is_inner = is_closed | ((i > 0) & (i < segments - 1))
        for _ in when(is_inner):
            roll[i] = inner_roll(lengths[i], lengths[before], lengths[after], kappa[i], kappa[after])
        for _ in when(logical_not(is_inner) & (segments > 1)):  # kappa of the node next to it, and of the one beyond
            one, near = select(i == 0, 1, i), select(i == 0, 1, i - 1)
            far = select(segments > 2, select(i == 0, 2, i - 2), near)
            next_one = select(segments > 2, select(i == 0, 2, i - 1), one)
            roll[i] = outer_roll(lengths[i], lengths[near], lengths[far], kappa[one], kappa[next_one])


@kernel("f8[:, :, :], i8, f8[:, :], i8[:, :], i8[:], f8[:, :]")
def smooth_rolls(u: Any, closed: Any, roll: Any, node: Any, nodes: Any, scratch: Any) -> None:
    """Set ``roll[k, i]``, the roll on arriving at sample i from the node before it, and which samples are nodes.

    `roll` and `node` hold 0 and 1 before. Working space: `nodes` (n,), `scratch` (3, n).
    """
    for k in loop(u.shape[0]):
        count = _choose_nodes(u[k], u.shape[1], nodes)
        _segment_rolls(u[k], nodes, count, closed != 0, scratch[0], scratch[1], scratch[2])
        for i in loop(1, u.shape[1]):
            node[k, i] = 0
        for i in loop(1, count):
            roll[k, nodes[i]] = scratch[2, i - 1]
            node[k, nodes[i]] = 1


def reflected(v: Vector, c: Vector) -> Vector:
    """Return v reflected in the plane orthogonal to c."""
    return v - 2.0 * (v @ c) / (c @ c) * c


@part
def transported(v: Vector, a: Vector, b: Vector, roll: Any) -> Any:
    """Carry v, orthogonal to a, to b by the minimal rotation, and turn it by `roll` about b.

    v is reflected in the plane orthogonal to a + b, which for a vector orthogonal to a is the minimal rotation.
    """
    w = Variables(x=reflected(v, a + b))
    for _ in when(roll != 0.0):
        w.x = cos(roll) * w.x + sin(roll) * cross(b, w.x)
    return tangent_to(w.x, b)


def tangent_to(x: Vector, b: Vector) -> Any:
    """Return x without round-off: in the tangent plane at b, and of unit length."""
    x = x - (b @ x) * b
    return (1.5 - 0.5 * (x @ x)) * x


def _set_frame(rows: Any, d1: Vector, d3: Vector) -> None:
    for i, d in enumerate((d1, cross(d3, d1), d3)):
        put(rows[i], d)


@kernel("f8[:, :, :], f8[:, :], f8[:, :], i8[:, :], f8[:, :, :, :] -> i8, i8, i8, i8, i8")
def transport_samples(u: Any, start: Any, roll: Any, node: Any, frames: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Transport ``start`` (m, 3) along the nodes by minimal rotations, each followed by its roll; fill `frames`.

    A sample that is no node takes its frame from the node before it.

    Returns the member and the two samples of the first antipodal pair (-1 if there is none), and the member and the
    second sample of the first pair more than a right angle apart.
    """
    found = Variables(member=-1, one=-1, other=-1, far_member=-1, far=-1)
    for k in loop(u.shape[0], whilst=lambda: found.member < 0):
        v = Variables(last=0, a=vector_at(u[k, 0]), d1=vector_at(start[k]))
        for i in loop(u.shape[1], whilst=lambda: found.member < 0):
            b = vector_at(u[k, i])
            s = v.a + b
            square = s @ s
            for _ in when(square < _RIGHT):
                for _ in when((square >= ANTIPODAL) & (found.far < 0)):
                    found.far_member, found.far = k, i
                for _ in when(square < ANTIPODAL):
                    found.member, found.one, found.other = k, v.last, i
            for _ in when(found.member < 0):
                d1 = transported(v.d1, v.a, b, roll[k, i])
                _set_frame(frames[k, i], d1, b)
                for _ in when(node[k, i] != 0):
                    v.last, v.a, v.d1 = i, b, d1
    return found.member, found.one, found.other, found.far_member, found.far


@kernel("f8[:, :, :], f8[:] -> i8, i8")
def solid_angles(u: Any, area: Any) -> tuple[Any, Any]:
    """Set the solid angle of the closed geodesic polygon of each member, in (-2 pi, 2 pi].

    The minimal rotations along the sides, multiplied as unit quaternions, leave a turn about the first vertex by the
    solid angle; a quaternion determines it modulo 4 pi. Returns member and second sample of the first antipodal side,
    or -1.
    """
    n, found = u.shape[1], Variables(member=-1, sample=-1)
    for k in loop(u.shape[0], whilst=lambda: found.member < 0):
        v = Variables(q=Quaternion(1.0, 0.0, 0.0, 0.0))
        for i in loop(1, n + 1, whilst=lambda: found.member < 0):
            j = select(i < n, i, 0)
            a, b = vector_at(u[k, i - 1]), vector_at(u[k, j])
            d, s = b - a, a + b
            plain = 2.0 - 0.5 * (d @ d)  # 1 + a.b
            w = select(plain < 0.1, 0.5 * (s @ s), plain)
            for _ in when(2.0 * w < ANTIPODAL):
                found.member, found.sample = k, j
            q = Quaternion(w, *cross(a, d)) @ v.q
            v.q = 1.0 / sqrt(q[0] * q[0] + q.vector @ q.vector) * q
        angle = 2.0 * arctan2(v.q.vector @ vector_at(u[k, 0]), v.q[0])
        area[k] = select(angle <= -2.0 * math.pi, 2.0 * math.pi, angle)
    return found.member, found.sample


@kernel("f8[:, :, :], f8[:, :, :], f8[:, :], f8[:, :, :, :] -> i8, i8")
def double_reflection(points: Any, u: Any, start: Any, frames: Any) -> tuple[Any, Any]:
    """Transport ``start`` along a curve by double reflection; (member, second sample) of the first bad step, or -1.

    The largest coordinate of `points` is about 1.
    """
    found = Variables(member=-1, sample=-1)
    for k in loop(u.shape[0], whilst=lambda: found.member < 0):
        v = Variables(d1=vector_at(start[k]), x=vector_at(start[k]), c=vector_at(start[k]))
        for i in loop(u.shape[1], whilst=lambda: found.member < 0):
            b = vector_at(u[k, i])
            for _ in when(i > 0):
                a, p = vector_at(u[k, i - 1]), vector_at(points[k, i]) - vector_at(points[k, i - 1])
                size = length(p)
                v.x, v.c = v.d1, b + a  # no chord: the minimal rotation of the tangent
                for _ in when(size > NO_CHORD):
                    e = p / size
                    v.x, v.c = v.d1 - 2.0 * (v.d1 @ e) * e, b - a + 2.0 * (a @ e) * e
                for _ in when(v.c @ v.c < ANTIPODAL):
                    found.member, found.sample = k, i
                v.d1 = tangent_to(reflected(v.x, v.c), b)
            _set_frame(frames[k, i], v.d1, b)
    return found.member, found.sample
