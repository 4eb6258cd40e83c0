"""Twist from quaternions: all samples at once, and sample by sample for any number of streams, with the same bits.

A stream has a row of `SIZE` numbers, zeros at the start: the state of its path (`path_kernels`), and what follows.
"""

from __future__ import annotations

import math

from .arrays import Array
from .compiled import kernel, shared
from .frame_kernels import carried
from .path_kernels import LAST, NEWEST, NODES, SETTLED, advance, begin, estimate, is_antipodal
from .path_kernels import SIZE as PATH

# Places of a row after its path: d1 carried along great circles; the quaternion, d1 of the body, d3 and time of the
# last sample; whether it was a node; its speed, rad a unit of time; angle at the start, twist now, twist one sample
# ago; steps that were flagged.
GREAT, QUATERNION, BODY, D3, TIME, IS_NODE, SPEED, BASE, TWIST, BEFORE, FLAGS, SIZE = (
    PATH + place for place in (0, 3, 7, 10, 13, 14, 15, 16, 17, 18, 19, 20)
)
_HALF_TURN = math.pi * (1.0 - 1e-9)
_TURN = 2.0 * math.pi


@shared
def _turned(x: float, y: float, z: float, w: float, ax: float, ay: float, az: float) -> tuple[float, float, float]:
    """Turn a vector by a unit quaternion."""
    px, py, pz = 2.0 * (y * az - z * ay), 2.0 * (z * ax - x * az), 2.0 * (x * ay - y * ax)
    return ax + w * px + (y * pz - z * py), ay + w * py + (z * px - x * pz), az + w * pz + (x * py - y * px)


@shared
def _axes(
    x: float, y: float, z: float, w: float, sign: float, triad: Array
) -> tuple[float, float, float, float, float, float]:
    """First and third vector of a triad in the body; `sign` is -1 for the inverse of the attitude."""
    size = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = sign * x / size, sign * y / size, sign * z / size, w / size
    ax, ay, az = _turned(x, y, z, w, triad[0, 0], triad[0, 1], triad[0, 2])
    dx, dy, dz = _turned(x, y, z, w, triad[2, 0], triad[2, 1], triad[2, 2])
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    return ax, ay, az, dx / size, dy / size, dz / size


@shared
def _angle(tx: float, ty: float, tz: float, dx: float, dy: float, dz: float, vx: float, vy: float, vz: float) -> float:
    """Angle about d from v to t."""
    wx, wy, wz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
    return math.atan2(tx * wx + ty * wy + tz * wz, tx * vx + ty * vy + tz * vz)


@shared
def _nearest(angle: float, last: float) -> float:
    """Return the angle, plus whole turns, that is nearest to the last one."""
    return angle + _TURN * math.floor((last - angle) / _TURN + 0.5)


@kernel("f8[:, :], f8, f8[:, :], f8[:, :], f8[:, :]")
def body_axes(quaternions: Array, sign: float, triad: Array, first: Array, d3: Array) -> None:
    """Set the first and the third vector of a triad that is fixed in the body, for quaternions, scalar last."""
    for i in range(quaternions.shape[0]):
        ax, ay, az, dx, dy, dz = _axes(
            quaternions[i, 0], quaternions[i, 1], quaternions[i, 2], quaternions[i, 3], sign, triad
        )
        first[i, 0], first[i, 1], first[i, 2] = ax, ay, az
        d3[i, 0], d3[i, 1], d3[i, 2] = dx, dy, dz


@kernel("f8[:, :], f8[:, :, :], f8[:]")
def angles(first: Array, frames: Array, psi: Array) -> None:
    """Set the angle from the frames to the vectors `first`, in whole turns as well, 0 at the start."""
    base = 0.0
    for i in range(first.shape[0]):
        angle = _angle(
            first[i, 0],
            first[i, 1],
            first[i, 2],
            frames[i, 2, 0],
            frames[i, 2, 1],
            frames[i, 2, 2],
            frames[i, 0, 0],
            frames[i, 0, 1],
            frames[i, 0, 2],
        )
        if i == 0:
            base, psi[0] = angle, 0.0
        else:
            psi[i] = _nearest(angle - base, psi[i - 1])


@shared
def _is_given(q: Array, k: int) -> bool:
    square = q[k, 0] * q[k, 0] + q[k, 1] * q[k, 1] + q[k, 2] * q[k, 2] + q[k, 3] * q[k, 3]
    is_given: bool = 0.0 < square < math.inf
    return is_given


@kernel("f8[:, :], f8[:, :], f8[:], i8, f8, f8[:, :], f8, f8[:, :] -> i8, i8")
def count(
    state: Array, given: Array, time: Array, order: int, sign: float, triad: Array, tolerance: float, found: Array
) -> tuple[int, int]:
    """Take each stream to its next sample; set twist, error, twist of the sample before and flags in `found`.

    A stream without a sample, not finite or zero, stays as it is. What is wrong and the stream: 1 a quaternion that is
    not of length 1 within `tolerance`, 2 a time that does not increase; 0 and -1 where nothing is, else no stream has
    moved.
    """
    m, one = state.shape[0], time.shape[0] == 1
    for k in range(m):
        if _is_given(given, k):
            square = given[k, 0] ** 2 + given[k, 1] ** 2 + given[k, 2] ** 2 + given[k, 3] ** 2
            if not abs(math.sqrt(square) - 1.0) <= tolerance:
                return 1, k
            if state[k, 0] > 0.0 and not time[0 if one else k] > state[k, TIME]:
                return 2, k
    for k in range(m):
        s = state[k]
        if _is_given(given, k):
            ax, ay, az, dx, dy, dz = _axes(given[k, 0], given[k, 1], given[k, 2], given[k, 3], sign, triad)
            if s[0] == 0.0:
                _begin(s, ax, ay, az, dx, dy, dz)
            else:
                _flag(s, given, k, time[0 if one else k])
                _move(s, order, ax, ay, az, dx, dy, dz)
            s[BODY], s[BODY + 1], s[BODY + 2] = ax, ay, az
            s[D3], s[D3 + 1], s[D3 + 2] = dx, dy, dz
            s[TIME] = time[0 if one else k]
            for i in range(4):
                s[QUATERNION + i] = given[k, i]
        found[k, 0], found[k, 1] = sign * s[TWIST], estimate(s, order) if s[0] > 0.0 else 0.0
        found[k, 2], found[k, 3] = sign * s[BEFORE], s[FLAGS]
    return 0, -1


@shared
def _begin(s: Array, ax: float, ay: float, az: float, dx: float, dy: float, dz: float) -> None:
    vx, vy, vz = carried(ax, ay, az, dx, dy, dz, dx, dy, dz, 0.0)
    begin(s, dx, dy, dz, vx, vy, vz)
    s[GREAT], s[GREAT + 1], s[GREAT + 2] = vx, vy, vz
    s[BASE], s[IS_NODE] = _angle(ax, ay, az, dx, dy, dz, vx, vy, vz), 1.0


@shared
def _flag(s: Array, given: Array, k: int, time: float) -> None:
    """Flag a step in which the body turned by half a turn, or at its speed would have turned by more."""
    dot, a, b = 0.0, 0.0, 0.0
    for i in range(4):
        p, q = s[QUATERNION + i], given[k, i]
        dot, a, b = dot + p * q, a + p * p, b + q * q
    turn, span = 2.0 * math.atan2(math.sqrt(max(a * b - dot * dot, 0.0)), abs(dot)), time - s[TIME]
    if max(turn, s[SPEED] * span) >= _HALF_TURN:
        s[FLAGS] += 1.0
    else:
        s[SPEED] = turn / span


@shared
def _move(s: Array, order: int, ax: float, ay: float, az: float, dx: float, dy: float, dz: float) -> None:
    """Take a stream to its next sample."""
    if is_antipodal(s, dx, dy, dz):
        s[FLAGS] = max(s[FLAGS], 1.0)  # which `_flag` has counted, up to round-off
        _start_again(s, ax, ay, az, dx, dy, dz)
        return
    cx, cy, cz = s[LAST], s[LAST + 1], s[LAST + 2]
    s[GREAT], s[GREAT + 1], s[GREAT + 2] = carried(s[GREAT], s[GREAT + 1], s[GREAT + 2], cx, cy, cz, dx, dy, dz, 0.0)
    is_node = advance(s, dx, dy, dz)
    vx, vy, vz = s[GREAT], s[GREAT + 1], s[GREAT + 2]
    s[BEFORE] = s[TWIST]
    if order == 4:
        if is_node:
            s[BEFORE] = s[TWIST] = _settled_twist(s)
            vx, vy, vz = s[NEWEST], s[NEWEST + 1], s[NEWEST + 2]
        else:
            n = NODES + 9
            vx, vy, vz = carried(s[NEWEST], s[NEWEST + 1], s[NEWEST + 2], s[n], s[n + 1], s[n + 2], dx, dy, dz, 0.0)
    s[IS_NODE] = 1.0 if is_node else 0.0
    s[TWIST] = _nearest(_angle(ax, ay, az, dx, dy, dz, vx, vy, vz) - s[BASE], s[TWIST])


@shared
def _settled_twist(s: Array) -> float:
    """Twist of the last sample, with the frame that has settled now that the path has moved on."""
    dx, dy, dz = s[D3], s[D3 + 1], s[D3 + 2]
    vx, vy, vz = s[SETTLED], s[SETTLED + 1], s[SETTLED + 2]
    if s[IS_NODE] == 0.0:
        n = NODES + 6
        vx, vy, vz = carried(vx, vy, vz, s[n], s[n + 1], s[n + 2], dx, dy, dz, 0.0)
    angle = _angle(s[BODY], s[BODY + 1], s[BODY + 2], dx, dy, dz, vx, vy, vz)
    return _nearest(angle - s[BASE], s[TWIST])


@shared
def _start_again(s: Array, ax: float, ay: float, az: float, dx: float, dy: float, dz: float) -> None:
    """Begin a new path where the axis has turned by half a turn, with the twist so far."""
    flags, speed, twist = s[FLAGS], s[SPEED], s[TWIST]
    for i in range(PATH):
        s[i] = 0.0
    _begin(s, ax, ay, az, dx, dy, dz)
    s[FLAGS], s[SPEED], s[TWIST], s[BEFORE] = flags, speed, twist, twist
    s[BASE] -= twist
