"""Writhe, link and twist of closed polygons: Lk = Tw + Wr on knots and links, digits, orders, degenerate curves."""

import os
from math import gcd

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from many_digits import exact, mp_cross, mp_dot
from nontwist.curves import closed_frame, curve_report, link, ribbon_twist, writhe
from nontwist.geometry import linking
from refusals import refused_as

TORUS = [(1, 0), (1, -4), (2, 3), (7, 2), (2, -4), (3, 3), (4, 6)]


def torus(p, q, n, part=0.0, R=2.0, r=0.8):
    """Points and outward normals of a curve that runs p times round the long way of a torus and q times the short way.

    Its sense is that of a right-handed screw for pq > 0; `part` of a turn turns it about the axis of the torus.
    """
    t = 2 * np.pi * np.arange(n) / n
    a, b = p * t + 2 * np.pi * part, q * t
    d = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), -np.sin(b)], axis=1)
    return R * np.stack([np.cos(a), np.sin(a), 0 * a], axis=1) + r * d, d


@pytest.mark.parametrize(("p", "q"), TORUS)
def test_torus_knots_and_links(p, q):
    """Of each component with its neighbour outside the torus, and of the components with one another: known numbers."""
    g = gcd(p, q)
    m, k = p // g, q // g
    parts = [torus(m, k, 60 * max(m, abs(k)), j / (q or 1)) for j in range(g)]
    for x, d1 in parts:
        found = ribbon_twist(x, d1) + writhe(x)
        assert found == pytest.approx(m * k, abs=1e-10)
        assert link(x, x + 1e-3 * d1) == m * k
        assert linking.gauss_integrals(x, x + 1e-3 * d1, closed=True)[0] == pytest.approx(m * k, abs=1e-10)
    for i in range(g):
        for j in range(i):
            assert link(parts[i][0], parts[j][0]) == link(parts[j][0], parts[i][0]) == m * k
            assert link(parts[i][0], parts[j][0][::-1]) == -m * k


def exact_writhe(x):
    """Sum of arc sines over pairs of segments (Klenin and Langowski, method 1a), to 40 digits."""
    n, total = len(x), mpmath.mpf(0)
    with mpmath.workdps(40):
        for i, j in [(k, m) for k in range(n) for m in range(k + 2, n - (k == 0))]:
            a, b, c, d = (exact(x[k % n]) for k in (i, i + 1, j, j + 1))
            normals = [mp_cross(s, t) for s, t in ((c - a, d - a), (d - a, d - b), (d - b, c - b), (c - b, c - a))]
            normals = [normal / mpmath.norm(normal) for normal in normals]
            pairs = zip(normals, normals[1:] + normals[:1], strict=True)
            area = sum(mpmath.asin(max(-1, min(1, mp_dot(s, t)))) for s, t in pairs)
            total += area * mpmath.sign(mp_dot(mp_cross(d - c, b - a), c - a))
        return float(total / (2 * mpmath.pi))


def test_writhe_against_many_digits():
    x = np.random.default_rng(0).normal(size=(9, 3))
    for points in (x, x * [1, 1, 1e-6]):
        assert writhe(points) == pytest.approx(exact_writhe(points), abs=1e-13)


def test_invariance_of_writhe_and_link():
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


def test_threads_change_no_bit(monkeypatch):
    x, found = torus(2, 3, 1250)[0], set()
    for threads in (1, 2, 5):
        monkeypatch.setattr(linking, "cores", lambda threads=threads: threads)
        found.add(writhe(x))
    assert len(found) == 1


def test_threads_of_allowed_processors(monkeypatch):
    """Of eight, this process may use one, as in a container or under taskset."""
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0}, raising=False)
    monkeypatch.setattr(linking, "ThreadPoolExecutor", None)
    assert np.isfinite(writhe(torus(2, 3, 1250)[0]))


def test_order_of_the_smooth_limit():
    curves = [torus(2, 3, n) for n in (100, 200, 400, 800)]
    for values in ([writhe(x) for x, _ in curves], [ribbon_twist(x, d1) for x, d1 in curves]):
        coarse, fine, *finest = values
        errors = abs(np.array([coarse, fine]) - (4 * finest[1] - finest[0]) / 3)
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
        assert errors[1] < 1.6e-3


def test_an_open_curve():
    """A helix has the twist of its Frenet frame: its coils times the sine of its pitch angle."""
    t = np.linspace(0, 8 * np.pi, 4001)
    helix = np.stack([np.cos(t), np.sin(t), 0.5 * t], axis=1)
    normal = np.stack([-np.cos(t), -np.sin(t), 0 * t], axis=1)
    assert ribbon_twist(helix, normal, closed=False) == pytest.approx(4 * 0.5 / np.hypot(1, 0.5), abs=2e-5)
    assert writhe(helix[:3], closed=False) == 0
    assert 0 < writhe(helix, closed=False) < 4


def test_edges_of_a_tetrahedron():
    """Elsewhere a corner, of the solid angle arccos(23/27), is seen before the others, or behind them."""
    report = curve_report([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
    share = 1 - 2 * np.arccos(23 / 27) / np.pi
    assert [report.mean_crossings, report.writhe] == pytest.approx([2 / 3 * share, 0], abs=1e-15)


@pytest.mark.parametrize(("knot", "turns"), [((2, -3), 3), ((1, 0), -2)])
def test_report_frames_twist_evenly(knot, turns):
    x, _ = torus(*knot, 120)
    x = x + 0.05 * np.random.default_rng(1).normal(size=x.shape) * (knot[1] != 0)
    report, plain = curve_report(x, turns=turns), curve_report(x)
    frame, lengths = report.frame.values, np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)
    assert frame @ frame.mT == pytest.approx(np.broadcast_to(np.eye(3), frame.shape), abs=1e-13)
    assert report.twist + report.writhe == pytest.approx(int(report.linking_number), abs=1e-10)
    assert report.linking_number == plain.linking_number + turns
    assert link(x, x + 1e-4 * frame[:, 0]) == report.linking_number
    share = linking._twists(frame[:, 0], *linking.directions(x, True), True)
    assert share == pytest.approx(float(report.twist) * lengths / lengths.sum(), abs=1e-12)
    assert 2 * np.pi * float(report.twist) == pytest.approx(2 * np.pi * turns - float(report.holonomy), abs=1e-10)
    assert report.length == pytest.approx(lengths.sum())
    assert report.arc_length.values == pytest.approx(np.cumsum(lengths) - lengths)
    edges = (np.roll(x, -1, axis=0) - x) / lengths[:, None]
    assert report.turning_angle.values == pytest.approx(np.arccos(np.sum(edges * np.roll(edges, 1, axis=0), axis=1)))
    assert report.total_curvature == pytest.approx(report.turning_angle.sum())
    assert report.total_curvature >= (2 if knot == (1, 0) else 4) * np.pi - 1e-9
    units = {name: variable.attrs.get("units") for name, variable in report.data_vars.items()}
    assert {name for name, unit in units.items() if unit == "rad"} == {"turning_angle", "total_curvature", "holonomy"}
    assert {name for name, unit in units.items() if unit is None} >= {"position", "length"}
    assert units["writhe"] == units["linking_number"] == "1"


def test_twist_is_even_along_points():
    """A stadium: the tangents move along its two half circles alone; its plane gives the frame that does not twist."""
    s, half = np.linspace(0, 3, 60, endpoint=False)[:, None], np.linspace(0, np.pi, 60, endpoint=False)[:, None]
    straight, bow = np.hstack([s, -1 + 0 * s, 0 * s]), np.hstack([3 + np.sin(half), -np.cos(half), 0 * half])
    points = np.concatenate([straight, bow, (3, 0, 0) - straight, (3, 0, 0) - bow])
    tangents = linking.directions(points, True)[1]
    frames, turned = closed_frame(tangents, (0, 0, 1), turns=-3, points=points)
    assert turned == closed_frame(tangents, (0, 0, 1), points=points)[1]
    angle = np.unwrap(np.arctan2(np.sum(frames[:, 0] * np.cross(tangents, (0, 0, 1.0)), axis=1), frames[:, 0, 2]))
    sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    expected = -6 * np.pi * np.append(0, np.cumsum(sides[:-1])) / sides.sum()
    assert angle == pytest.approx(expected, abs=1e-12)
    assert ribbon_twist(points, frames[:, 0]) == pytest.approx(-3, abs=1e-10)


RING = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])

EIGHT = np.array([[1, 1, 0], [-1, -1, 0.0], [-1, 1, 1], [1, -1, -1]])  # edges 0 and 2 cross at the origin
test_refusals = refused_as(
    {
        "two points": lambda: writhe(RING[[0, 1, 0]]),
        "repeated": lambda: ribbon_twist(RING[[0, 1, 1, 2, 3]], np.ones((5, 3))),
        "through itself": lambda: writhe(EIGHT),
        "through itself, report": lambda: curve_report(EIGHT),
        "meet": lambda: link(RING, RING[:, [1, 2, 0]] + [1, 0, 1]),
        "coincide": lambda: link(RING, np.array([*RING[[2, 3]], (0, 0, 9)])),
        "turns back": lambda: curve_report([[0, 0, 0], [3, 0, 0], [1, 0, 0], [1, 1, 0]]),
        "d1 along": lambda: ribbon_twist(RING, linking.directions(RING.astype(float), True)[1]),
        "d1 of other points": lambda: ribbon_twist(RING, np.ones((3, 3))),
    }
)
