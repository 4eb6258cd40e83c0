"""Writhe, link and twist of closed polygons: Lk = Tw + Wr on knots and links, digits, orders, degenerate curves."""

import re
from math import gcd

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nontwist.curves import closed_frame, curve_report, link, ribbon_twist, writhe
from nontwist.geometry import linking

TORUS = [
    (1, 0), (1, 1), (1, -4), (2, 3), (3, 2), (2, -3), (2, 5), (2, 7), (3, 4), (3, -5), (4, 5), (5, 3), (7, 2),
    (2, 2), (2, -4), (2, 6), (3, 3), (3, 6), (4, 6), (6, -4),
]  # fmt: skip


def torus(p, q, n, part=0.0, R=2.0, r=0.8):
    """Points and outward normals of a curve that runs p times round the long way of a torus and q times the short way.

    Its sense is that of a right-handed screw for pq > 0; `part` of a turn turns it about the axis of the torus.
    """
    t = 2 * np.pi * np.arange(n) / n
    a, b = p * t + 2 * np.pi * part, q * t
    d = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), -np.sin(b)], axis=1)
    return R * np.stack([np.cos(a), np.sin(a), 0 * a], axis=1) + r * d, d


@pytest.mark.parametrize(("p", "q"), TORUS)
def test_linking_number_is_twist_and_writhe_of_torus_knots_and_links(p, q):
    """Of each component with its neighbour outside the torus, and of the components with one another: known numbers."""
    g = gcd(p, q)
    m, k = p // g, q // g
    parts = [torus(m, k, 120 * max(m, abs(k)), j / (q or 1)) for j in range(g)]
    for x, d1 in parts:
        found = ribbon_twist(x, d1) + writhe(x)
        assert found == pytest.approx(m * k, abs=1e-10)
        assert link(x, x + 1e-3 * d1) == m * k
        assert linking.integrals(x, x + 1e-3 * d1, closed=True)[0] == pytest.approx(m * k, abs=1e-10)
    for i in range(g):
        for j in range(i):
            assert link(parts[i][0], parts[j][0]) == link(parts[j][0], parts[i][0]) == m * k
            assert link(parts[i][0], parts[j][0][::-1]) == -m * k


def exact_writhe(x):
    """Sum of arc sines over pairs of segments (Klenin and Langowski, method 1a), to 40 digits."""
    with mpmath.workdps(40):
        points = [[mpmath.mpf(float(c)) for c in v] for v in x]

        def minus(a, b):
            return [s - t for s, t in zip(a, b, strict=True)]

        def cross(a, b):
            return [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]

        def dot(a, b):
            return sum(s * t for s, t in zip(a, b, strict=True))

        def unit(a):
            return [s / mpmath.sqrt(dot(a, a)) for s in a]

        n, total = len(points), mpmath.mpf(0)
        for i in range(n):
            for j in range(i + 2, n - (i == 0)):
                a, b, c, d = points[i], points[i + 1], points[j], points[(j + 1) % n]
                normals = [(c, d), (d, 1), (1, 0), (0, c)]
                r13, r14, r23, r24 = minus(c, a), minus(d, a), minus(c, b), minus(d, b)
                normals = [unit(cross(s, t)) for s, t in ((r13, r14), (r14, r24), (r24, r23), (r23, r13))]
                area = sum(
                    mpmath.asin(max(-1, min(1, dot(s, t))))
                    for s, t in zip(normals, normals[1:] + normals[:1], strict=True)
                )
                total += area * mpmath.sign(dot(cross(minus(d, c), minus(b, a)), r13))
        return float(total / (2 * mpmath.pi))


@pytest.mark.parametrize("seed", range(6))
def test_writhe_against_many_digits(seed):
    x = np.random.default_rng(seed).normal(size=(9, 3))
    assert writhe(x) == pytest.approx(exact_writhe(x), abs=1e-13)
    flat = x * [1, 1, 1e-6]
    assert writhe(flat) == pytest.approx(exact_writhe(flat), abs=1e-13)


def test_what_writhe_and_link_do_not_depend_on():
    (x, d1), y = torus(2, 3, 200), torus(1, 1, 150, 0.3, r=1.2)[0]
    turn = Rotation.random(rng=np.random.default_rng(1))
    found = writhe(x)
    for same in (turn.apply(x) * 1e-8, 1e8 * x + 1e9, x[::-1], np.roll(x, 7, axis=0), np.concatenate([x, x[:1]])):
        assert writhe(same) == pytest.approx(found, abs=1e-8)
    assert writhe(x * [1, 1, -1]) == pytest.approx(-found, abs=1e-12)
    assert abs(writhe(x * [1, 1, 0] + [0, 0, 5], closed=False)) < 1e-14
    assert link(turn.apply(x), turn.apply(y)) == link(x, y)
    twist = ribbon_twist(x, d1)
    assert ribbon_twist(x, 1e-9 * d1) == pytest.approx(twist, abs=1e-12)
    assert ribbon_twist(np.concatenate([x, x[:1]]), np.concatenate([d1, d1[:1]])) == twist
    assert ribbon_twist(x[::-1], d1[::-1]) == pytest.approx(twist, abs=1e-12)


def test_the_number_of_threads_changes_no_bit(monkeypatch):
    x = torus(2, 3, 1500)[0]
    found = []
    for threads in (1, 2, 5):
        monkeypatch.setattr(linking.os, "cpu_count", lambda threads=threads: threads)
        found.append(writhe(x))
    assert len(set(found)) == 1


@pytest.mark.parametrize("quantity", ["writhe", "twist"])
def test_order_two_in_the_smooth_limit(quantity):
    def value(n):
        x, d1 = torus(2, 3, n)
        return writhe(x) if quantity == "writhe" else ribbon_twist(x, d1)

    exact = (4 * value(3200) - value(1600)) / 3
    errors = [abs(value(n) - exact) for n in (100, 200, 400, 800)]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2, abs=0.1)
    assert errors[-1] < 1e-4


def test_an_open_curve():
    """A helix has the twist of its Frenet frame: its coils times the sine of its pitch angle."""
    t = np.linspace(0, 8 * np.pi, 4001)
    helix = np.stack([np.cos(t), np.sin(t), 0.5 * t], axis=1)
    normal = np.stack([-np.cos(t), -np.sin(t), 0 * t], axis=1)
    assert ribbon_twist(helix, normal, closed=False) == pytest.approx(4 * 0.5 / np.hypot(1, 0.5), abs=2e-5)
    assert writhe(helix[:3], closed=False) == 0
    assert 0 < writhe(helix, closed=False) < 4


@pytest.mark.parametrize("turns", [0, 3, -2])
@pytest.mark.parametrize("knot", [(2, 3), (3, -4), (1, 0)])
def test_frames_of_a_report_close_and_twist_evenly(knot, turns):
    x, _ = torus(*knot, 240)
    x = x + 0.05 * np.random.default_rng(1).normal(size=x.shape) * (knot[1] != 0)
    report, plain = curve_report(x, turns=turns), curve_report(x)
    frame, edges = report.frame.values, np.roll(x, -1, axis=0) - x
    assert np.einsum("nij,nkj->nik", frame, frame) == pytest.approx(np.broadcast_to(np.eye(3), frame.shape), abs=1e-13)
    assert report.twist + report.writhe == pytest.approx(int(report.linking_number), abs=1e-10)
    assert report.linking_number == plain.linking_number + turns
    assert link(x, x + 1e-4 * frame[:, 0]) == report.linking_number
    share = linking._twists(frame[:, 0], *linking.directions(x, True), True)
    lengths = np.linalg.norm(edges, axis=1)
    assert share == pytest.approx(float(report.twist) * lengths / lengths.sum(), abs=1e-12)
    assert 2 * np.pi * float(report.twist) == pytest.approx(2 * np.pi * turns - float(report.holonomy), abs=1e-10)
    assert report.length == pytest.approx(lengths.sum())
    assert report.arc_length[-1] == pytest.approx(lengths[:-1].sum())
    assert report.mean_crossings >= abs(report.writhe)
    assert report.total_curvature == pytest.approx(report.turning_angle.sum())
    assert report.total_curvature >= (4 if knot == (2, 3) else 2) * np.pi - 1e-9


def test_turns_of_closed_frames():
    t = 2 * np.pi * np.arange(400) / 400
    tangents = np.stack([-np.sin(t), np.cos(t), 0 * t], axis=1)
    points = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    for turns in (1, -3):
        frames, angle = closed_frame(tangents, (0, 0, 1), turns=turns)
        plain, same = closed_frame(tangents, (0, 0, 1))
        assert angle == same
        side = np.cross(tangents, plain[:, 0])
        turned = np.unwrap(np.arctan2(np.sum(frames[:, 0] * side, axis=1), np.sum(frames[:, 0] * plain[:, 0], axis=1)))
        assert turned == pytest.approx(turns * t, abs=1e-12)
        assert ribbon_twist(points, frames[:, 0]) == pytest.approx(turns, abs=1e-10)


def test_the_twist_is_even_along_the_points_where_they_are_given():
    """A stadium: the tangents move along its two half circles alone."""
    s, half = np.linspace(0, 3, 60, endpoint=False)[:, None], np.linspace(0, np.pi, 60, endpoint=False)[:, None]
    straight, bow = np.hstack([s, -1 + 0 * s, 0 * s]), np.hstack([3 + np.sin(half), -np.cos(half), 0 * half])
    points = np.concatenate([straight, bow, (3, 0, 0) - straight, (3, 0, 0) - bow])
    tangents = linking.directions(points, True)[1]
    frames, _ = closed_frame(tangents, (0, 0, 1), turns=2, points=points)
    angle = np.unwrap(np.arctan2(np.sum(frames[:, 0] * np.cross(tangents, (0, 0, 1.0)), axis=1), frames[:, 0, 2]))
    sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    expected = 4 * np.pi * np.append(0, np.cumsum(sides[:-1])) / sides.sum()
    assert angle == pytest.approx(expected, abs=1e-12)
    with pytest.raises(ValueError, match=r"points must have the shape of d3, \(240, 3\), got \(239, 3\)"):
        closed_frame(tangents, points=points[1:])
    with pytest.raises(ValueError, match="turns must be a whole number"):
        closed_frame(tangents, turns=0.5)


RING = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])


def refused(message, function, *arguments):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}"):
        function(*arguments)


@pytest.mark.parametrize("function", [writhe, curve_report, lambda x: ribbon_twist(x, x), lambda x: link(x, RING)])
def test_degenerate_curves_are_refused(function):
    name = "a" if "link" in function.__code__.co_names else "points"
    refused(f"{name} must contain at least 3 different points of a closed curve, got 2", function, RING[[0, 1, 0]])
    refused(f"{name} must contain at least 3 different points of a closed curve, got 0", function, np.zeros((0, 3)))
    refused(f"{name}[1] and {name}[2] coincide: drop repeated points", function, RING[[0, 1, 1, 2, 3]])
    refused(f"{name}[0] and {name}[4] coincide", function, np.concatenate([RING, RING[:1], RING + np.array([0, 0, 1])]))
    refused(f"{name} must have the shape (n, 3), got (4, 2)", function, RING[:, :2])
    refused(f"{name}[2, 1] = nan is not finite", function, np.where(np.arange(12).reshape(4, 3) == 7, np.nan, RING))


def test_curves_that_meet_or_turn_back_are_refused():
    eight = np.array([[1, 1, 0], [-1, -1, 0.0], [-1, 1, 1], [1, -1, -1]])  # edges 0 and 2 cross at the origin
    refused(
        "the curve runs through itself: its writhe does not fit the area that its tangents enclose, by", writhe, eight
    )
    refused("the curve runs through itself", curve_report, eight)
    refused("a and b meet: their Gauss integral is", link, RING, RING[:, [1, 2, 0]] + [1, 0, 1])
    refused("a[2] and b[0] coincide: the curves meet", link, RING, np.array([*RING[[2, 3]], (0, 0, 9)]))
    refused("a[2] and b[2] coincide", link, RING, RING)
    back = np.array([[0, 0, 0], [3, 0, 0], [1, 0, 0], [1, 1, 0]])
    refused("the curve turns back on itself at points[1]", writhe, back)
    refused("the curve turns back on itself at points[1]", curve_report, back)
    refused(
        "d1[2] is zero or parallel to the tangent there",
        ribbon_twist,
        RING,
        [(0, 0, 1), (0, 0, 1), (0, 0, 0), (0, 0, 1)],
    )
    refused("d1[0] is zero or parallel", ribbon_twist, RING, linking.directions(RING.astype(float), True)[1])
    refused("d1 must have one vector for each of the 4 points, got 3", ribbon_twist, RING, np.ones((3, 3)))
    with pytest.raises(ValueError, match="closed must be True or False, got 1"):
        writhe(RING, closed=1)
