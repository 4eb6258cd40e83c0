"""Twist from quaternions: all samples at once, and sample by sample for any number of streams, with the same bits.

A stream has a `Stream`, zeros at the start: the state of its path (`path_kernels`), and what follows.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..kernels.control import Variables, loop, when
from ..kernels.elements import arctan2, floor, larger, logical_not, select, sqrt
from ..kernels.kernel import kernel, part
from ..kernels.memory import View, matrix_at, put, size_of, vector_at, view_in
from ..kernels.vectors import Matrix, Quaternion, Vector, cross
from .arrays import Array
from .frame_kernels import length, transported
from .path_kernels import Path, add_sample, begin, estimate, is_antipodal


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
        s.before = s.twist
        for _ in when(is_node & (order == 4)):
            settled = _settled_twist(s)
            s.before, s.twist = settled, settled
            v.d1 = s.path.newest
        for _ in when(logical_not(is_node) & (order == 4)):
            v.d1 = transported(s.path.newest, s.path.n3, d3, none)
        s.is_node = select(is_node, 1.0, 0.0)
        s.twist = _nearest(_angle(d1, d3, v.d1) - s.base, s.twist)


def _settled_twist(s: View) -> Any:
    """Return the twist of the last sample, with the frame that has settled now that the path has moved on."""
    v = Variables(d1=s.path.settled)
    for _ in when(s.is_node == 0.0):
        v.d1 = transported(v.d1, s.path.n2, s.d3, 0.0 * s.time)
    return _nearest(_angle(s.body, s.d3, v.d1) - s.base, s.twist)


def _start_again(s: View, d1: Vector, d3: Vector) -> None:
    """Begin a new path where the axis has turned by half a turn, with the twist so far."""
    for i in loop(size_of(Path)):
        s.path.set_number(i, 0.0)
    _start(s, d1, d3)
    s.before, s.base = s.twist, s.base - s.twist
