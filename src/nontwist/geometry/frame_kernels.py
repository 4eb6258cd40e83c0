"""Compiled loops of the non-twisting frames; `frames` derives them.

Every array has one member axis first: directors ``u`` (m, n, 3), unit vectors; frames (m, n, 3, 3), rows d1, d2, d3.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .compiled import kernel, shared

# A chord below this fraction of its neighbour carries no curvature: noise of the samples divided by the chord.
SHORT = 1e-3
# A chord up to which two samples count as one: the frame is right without it up to 1e-100 rad, and products of several
# such chords and of curvatures, their inverses, would be too small or too large for a float.
NO_CHORD = 1e-50
# Squared length of d_i + d_(i+1) below which the two count as antipodal: 1e-7 rad from it the great circle is noise.
ANTIPODAL = 1e-14
# The same length at a right angle, less round-off.
_RIGHT = 2.0 - 1e-9


@kernel("f8[:, :, :], f8 -> i8, i8")
def normalise(u: Array, tolerance: float) -> tuple[int, int]:
    """Make every row of `u` a unit vector; (member, sample) of the first that is none within `tolerance`, or -1."""
    for k in range(u.shape[0]):
        for i in range(u.shape[1]):
            x, y, z = u[k, i, 0], u[k, i, 1], u[k, i, 2]
            length = math.sqrt(x * x + y * y + z * z)
            if not abs(length - 1.0) <= tolerance:  # not a number fails as well
                return k, i
            u[k, i, 0], u[k, i, 1], u[k, i, 2] = x / length, y / length, z / length
    return -1, -1


@shared
def distance(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:
    """Chord between two points."""
    x, y, z = bx - ax, by - ay, bz - az
    return math.sqrt(x * x + y * y + z * z)


@shared
def _chord(u: Array, k: int, i: int, j: int) -> float:
    return distance(u[k, i, 0], u[k, i, 1], u[k, i, 2], u[k, j, 0], u[k, j, 1], u[k, j, 2])


@shared
def _nodes(u: Array, k: int, nodes: NDArray[np.int64]) -> int:
    """Choose the samples that carry curvature: all but those whose path since the last one chosen is next to nothing.

    That is none, or at most `SHORT` times the chord before; a chord up to `NO_CHORD` is none. A long rest with small
    motion has a longer path, and is kept. At the start, where there is no chord before, it is the path so far that is
    next to nothing beside a chord after it. Else the choice does not depend on later samples.
    """
    count, before, run, whole = 1, 0.0, 0.0, 0.0
    nodes[0] = 0
    for i in range(1, u.shape[1]):
        step = _chord(u, k, i - 1, i)
        run += step
        if run > SHORT * before:
            here = _chord(u, k, nodes[count - 1], i)
            if here > NO_CHORD:
                if whole <= SHORT * step:
                    count, here = 1, _chord(u, k, 0, i)
                nodes[count] = i
                count, before, run = count + 1, here, 0.0
        whole += step
    return count


@shared
def curvature(
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    cx: float,
    cy: float,
    cz: float,
    l: float,
    m: float,
) -> float:
    """Geodesic curvature of three points with the chords l and m between them, at their centroid."""
    px, py, pz = bx - ax, by - ay, bz - az
    qx, qy, qz = cx - bx, cy - by, cz - bz
    det = bx * (py * qz - pz * qy) + by * (pz * qx - px * qz) + bz * (px * qy - py * qx)
    return 2.0 * det / (l * m * (l + m))


@shared
def inner_roll(l: float, lm: float, lp: float, kl: float, kr: float) -> float:
    """Roll of a segment of length l between two others, with the curvatures at its ends.

    Of these the one that comes from a much shorter neighbour is not used.
    """
    middle = 0.0
    if lm >= SHORT * l and lp >= SHORT * l:
        middle = kl + (lm + 0.5 * l) / (lm + l + lp) * (kr - kl)
    elif lp >= SHORT * l:
        middle = kr
    elif lm >= SHORT * l:
        middle = kl
    return middle * l * l * l / 12.0


@shared
def outer_roll(l: float, near: float, far: float, k: float, next_k: float) -> float:
    """Roll of a segment of length l at an end, extrapolated; `far` is 0 where there is no third segment."""
    middle = 0.0
    if near >= SHORT * l:
        middle = k
        if far > 0.0 and far >= SHORT * near:
            middle -= (near + 0.5 * l) / (l + near + far) * (next_k - k)
    return middle * l * l * l / 12.0


@shared
def _segment_rolls(
    u: Array, k: int, nodes: NDArray[np.int64], count: int, closed: bool, length: Array, kappa: Array, roll: Array
) -> None:
    """Roll that a smooth curve through the nodes has against the great circles, ``kappa l^3 / 12`` in each segment.

    Segment i runs from node i to node i + 1. On a closed curve the last node is the first one again.
    """
    segments = count - 1
    for i in range(segments):
        length[i] = _chord(u, k, nodes[i], nodes[i + 1])
    for i in range(0 if closed else 1, segments):  # kappa[i] belongs to node i
        before = i - 1 if i > 0 else segments - 1
        a, b, c = nodes[before], nodes[i], nodes[i + 1]
        kappa[i] = curvature(
            u[k, a, 0],
            u[k, a, 1],
            u[k, a, 2],
            u[k, b, 0],
            u[k, b, 1],
            u[k, b, 2],
            u[k, c, 0],
            u[k, c, 1],
            u[k, c, 2],
            length[before],
            length[i],
        )
    for i in range(segments):
        before, after = i - 1 if i > 0 else segments - 1, i + 1 if i + 1 < segments else 0
        if closed or 0 < i < segments - 1:
            roll[i] = inner_roll(length[i], length[before], length[after], kappa[i], kappa[after])
        elif segments == 1:
            roll[i] = 0.0
        elif i == 0:
            far = length[2] if segments > 2 else 0.0
            roll[i] = outer_roll(length[0], length[1], far, kappa[1], kappa[2] if segments > 2 else 0.0)
        else:
            far = length[i - 2] if segments > 2 else 0.0
            roll[i] = outer_roll(length[i], length[i - 1], far, kappa[i], kappa[i - 1] if segments > 2 else 0.0)


@kernel("f8[:, :, :], i8, f8[:, :], i8[:, :], i8[:], f8[:, :]")
def smooth_rolls(
    u: Array, closed: int, roll: Array, node: NDArray[np.int64], nodes: NDArray[np.int64], room: Array
) -> None:
    """Set ``roll[k, i]``, the roll on arriving at sample i from the node before it, and which samples are nodes.

    Working space: `nodes` (n,), `room` (3, n).
    """
    m, n = u.shape[0], u.shape[1]
    length, kappa, segment = room[0], room[1], room[2]
    for k in range(m):
        count = _nodes(u, k, nodes)
        _segment_rolls(u, k, nodes, count, closed != 0, length, kappa, segment)
        for i in range(n):
            roll[k, i] = 0.0
            node[k, i] = 0
        node[k, 0] = 1
        for i in range(1, count):
            roll[k, nodes[i]] = segment[i - 1]
            node[k, nodes[i]] = 1


@shared
def carried(
    vx: float, vy: float, vz: float, ax: float, ay: float, az: float, bx: float, by: float, bz: float, roll: float
) -> tuple[float, float, float]:
    """Carry v, orthogonal to a, to b by the minimal rotation, and turn it by `roll` about b.

    v is reflected in the plane orthogonal to a + b, which for a vector orthogonal to a is the minimal rotation.
    """
    cx, cy, cz = ax + bx, ay + by, az + bz
    f = 2.0 * (vx * cx + vy * cy + vz * cz) / (cx * cx + cy * cy + cz * cz)
    x, y, z = vx - f * cx, vy - f * cy, vz - f * cz
    if roll != 0.0:
        s, c = math.sin(roll), math.cos(roll)
        x, y, z = (
            c * x + s * (by * z - bz * y),
            c * y + s * (bz * x - bx * z),
            c * z + s * (bx * y - by * x),
        )
    f = bx * x + by * y + bz * z  # round-off: back into the tangent plane, back to unit length
    x, y, z = x - f * bx, y - f * by, z - f * bz
    f = 1.5 - 0.5 * (x * x + y * y + z * z)
    return f * x, f * y, f * z


@kernel("f8[:, :, :], f8[:, :], f8[:, :], i8[:, :], f8[:, :, :, :] -> i8, i8, i8, i8, i8")
def transport(
    u: Array, start: Array, roll: Array, node: NDArray[np.int64], frames: Array
) -> tuple[int, int, int, int, int]:
    """Transport ``start`` (m, 3) along the nodes by minimal rotations, each followed by its roll; fill `frames`.

    A sample that is no node takes its frame from the node before it.

    Returns the member and the two samples of the first antipodal pair (-1 if there is none), and the member and the
    second sample of the first pair more than a right angle apart.
    """
    wide_member, wide = -1, -1
    for k in range(u.shape[0]):
        last = 0
        ax, ay, az = u[k, 0, 0], u[k, 0, 1], u[k, 0, 2]
        vx, vy, vz = start[k, 0], start[k, 1], start[k, 2]
        for i in range(u.shape[1]):
            bx, by, bz = u[k, i, 0], u[k, i, 1], u[k, i, 2]
            square = (ax + bx) ** 2 + (ay + by) ** 2 + (az + bz) ** 2
            if square < _RIGHT:
                if square < ANTIPODAL:
                    return k, last, i, wide_member, wide
                if wide < 0:
                    wide_member, wide = k, i
            x, y, z = carried(vx, vy, vz, ax, ay, az, bx, by, bz, roll[k, i])
            frames[k, i, 0, 0], frames[k, i, 0, 1], frames[k, i, 0, 2] = x, y, z
            frames[k, i, 1, 0], frames[k, i, 1, 1], frames[k, i, 1, 2] = (
                by * z - bz * y,
                bz * x - bx * z,
                bx * y - by * x,
            )
            frames[k, i, 2, 0], frames[k, i, 2, 1], frames[k, i, 2, 2] = bx, by, bz
            if node[k, i] != 0:
                last = i
                ax, ay, az = bx, by, bz
                vx, vy, vz = x, y, z
    return -1, -1, -1, wide_member, wide


@kernel("f8[:, :, :, :], f8[:, :, :], f8, f8[:]")
def close(frames: Array, points: Array, angle: float, holonomy: Array) -> None:
    """Turn the frames back about d3 by the holonomy, in proportion to the length of `points`: the last meets the first.

    ``frames[:, -1]`` has the same director as ``frames[:, 0]``; `holonomy` (m,) receives the angle between them. The
    frames turn forward by `angle` besides, a number of whole turns.
    """
    n = frames.shape[1]
    for k in range(frames.shape[0]):
        y, x, total = 0.0, 0.0, 0.0
        for j in range(3):
            x += frames[k, n - 1, 0, j] * frames[k, 0, 0, j]
            y += frames[k, n - 1, 0, j] * frames[k, 0, 1, j]
        holonomy[k] = math.atan2(y, x)
        if holonomy[k] <= -math.pi:
            holonomy[k] = math.pi
        share = angle - holonomy[k]
        for sweep in range(2):  # first the whole length, then the turning
            path = 0.0
            for i in range(1, n):
                square = 0.0
                for j in range(3):
                    square += (points[k, i, j] - points[k, i - 1, j]) ** 2
                path += math.sqrt(square)
                if sweep == 1 and total > 0.0:
                    s, c = math.sin(share * path / total), math.cos(share * path / total)
                    for j in range(3):
                        d1, d2 = frames[k, i, 0, j], frames[k, i, 1, j]
                        frames[k, i, 0, j] = c * d1 + s * d2
                        frames[k, i, 1, j] = c * d2 - s * d1
            total = path


@kernel("f8[:, :, :], f8[:] -> i8, i8")
def solid_angles(u: Array, area: Array) -> tuple[int, int]:
    """Solid angle of the closed geodesic polygon of each member, in (-2 pi, 2 pi].

    The minimal rotations along the sides, multiplied as unit quaternions, leave a turn about the first vertex by the
    solid angle; a quaternion determines it modulo 4 pi. Returns member and second sample of the first antipodal side,
    or -1.
    """
    n = u.shape[1]
    for k in range(u.shape[0]):
        w, x, y, z = 1.0, 0.0, 0.0, 0.0
        for i in range(1, n + 1):
            j = i if i < n else 0
            ax, ay, az = u[k, i - 1, 0], u[k, i - 1, 1], u[k, i - 1, 2]
            dx, dy, dz = u[k, j, 0] - ax, u[k, j, 1] - ay, u[k, j, 2] - az
            rw = 2.0 - 0.5 * (dx * dx + dy * dy + dz * dz)  # 1 + a.b
            if rw < 0.1:
                sx, sy, sz = ax + u[k, j, 0], ay + u[k, j, 1], az + u[k, j, 2]
                rw = 0.5 * (sx * sx + sy * sy + sz * sz)
                if 2.0 * rw < ANTIPODAL:
                    return k, j
            rx, ry, rz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
            w, x, y, z = (
                rw * w - rx * x - ry * y - rz * z,
                rw * x + w * rx + ry * z - rz * y,
                rw * y + w * ry + rz * x - rx * z,
                rw * z + w * rz + rx * y - ry * x,
            )
            f = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
            w, x, y, z = f * w, f * x, f * y, f * z
        area[k] = 2.0 * math.atan2(x * u[k, 0, 0] + y * u[k, 0, 1] + z * u[k, 0, 2], w)
        if area[k] <= -2.0 * math.pi:
            area[k] = 2.0 * math.pi
    return -1, -1


@kernel("f8[:, :, :], f8[:], f8[:] -> i8, i8")
def windings(u: Array, pole: Array, total: Array) -> tuple[int, int]:
    """Sum of the triangles from `pole` to the sides; (member, second sample) of the first side through -pole, or -1."""
    n = u.shape[1]
    px, py, pz = pole[0], pole[1], pole[2]
    for k in range(u.shape[0]):
        total[k] = 0.0
        for i in range(1, n + 1):
            j = i if i < n else 0
            ax, ay, az = u[k, i - 1, 0], u[k, i - 1, 1], u[k, i - 1, 2]
            bx, by, bz = u[k, j, 0], u[k, j, 1], u[k, j, 2]
            det = px * (ay * bz - az * by) + py * (az * bx - ax * bz) + pz * (ax * by - ay * bx)
            rest = 1.0 + px * (ax + bx) + py * (ay + by) + pz * (az + bz) + ax * bx + ay * by + az * bz
            if abs(det) <= ANTIPODAL and rest <= ANTIPODAL:
                return k, j
            total[k] += 2.0 * math.atan2(det, rest)
    return -1, -1


@kernel("f8[:, :, :], f8[:, :, :], f8[:, :], f8[:, :, :, :] -> i8, i8")
def double_reflection(points: Array, u: Array, start: Array, frames: Array) -> tuple[int, int]:
    """Transport ``start`` along a curve by double reflection; (member, second sample) of the first bad step, or -1.

    The largest coordinate of `points` is about 1.
    """
    for k in range(u.shape[0]):
        vx, vy, vz = start[k, 0], start[k, 1], start[k, 2]
        for i in range(u.shape[1]):
            bx, by, bz = u[k, i, 0], u[k, i, 1], u[k, i, 2]
            if i > 0:
                ax, ay, az = u[k, i - 1, 0], u[k, i - 1, 1], u[k, i - 1, 2]
                px = points[k, i, 0] - points[k, i - 1, 0]
                py = points[k, i, 1] - points[k, i - 1, 1]
                pz = points[k, i, 2] - points[k, i - 1, 2]
                length = math.sqrt(px * px + py * py + pz * pz)
                if length > NO_CHORD:
                    px, py, pz = px / length, py / length, pz / length
                    f = 2.0 * (vx * px + vy * py + vz * pz)
                    vx, vy, vz = vx - f * px, vy - f * py, vz - f * pz
                    f = 2.0 * (ax * px + ay * py + az * pz)
                    cx, cy, cz = bx - ax + f * px, by - ay + f * py, bz - az + f * pz
                else:  # no chord: the minimal rotation of the tangent
                    cx, cy, cz = bx + ax, by + ay, bz + az
                square = cx * cx + cy * cy + cz * cz
                if square < ANTIPODAL:
                    return k, i
                f = 2.0 * (vx * cx + vy * cy + vz * cz) / square
                vx, vy, vz = vx - f * cx, vy - f * cy, vz - f * cz
                f = bx * vx + by * vy + bz * vz
                vx, vy, vz = vx - f * bx, vy - f * by, vz - f * bz
                f = 1.5 - 0.5 * (vx * vx + vy * vy + vz * vz)
                vx, vy, vz = f * vx, f * vy, f * vz
            frames[k, i, 0, 0], frames[k, i, 0, 1], frames[k, i, 0, 2] = vx, vy, vz
            frames[k, i, 1, 0], frames[k, i, 1, 1], frames[k, i, 1, 2] = (
                by * vz - bz * vy,
                bz * vx - bx * vz,
                bx * vy - by * vx,
            )
            frames[k, i, 2, 0], frames[k, i, 2, 1], frames[k, i, 2, 2] = bx, by, bz
    return -1, -1
