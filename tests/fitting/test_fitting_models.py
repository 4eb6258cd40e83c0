"""Inertias by recordings of bodies on which something acts: gravity about a pivot, a rotor, damping."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import ended
from fit_errors import CENTRE, FREE, HEADER, MASS, apart, csv, differences, farthest, off_by, recorded, whole
from fit_errors import PIVOTED as J
from nontwist.fitting.estimating import pencil, short, with_moments
from nontwist.fitting.measuring import IDEAL, Gyroscope, as_speed
from nontwist.fitting.predictions import Line, Motion, Track, responses
from nontwist.fitting.shooting import Shooting, Stretch, Unknowns
from nontwist.fitting.solving import solve
from nontwist.fitting.telling import covariance, quantile
from nontwist.fitting.unknowns import Model, Pivot, Wheel, entries, symmetric
from nontwist.geometry.attitudes import ENTRIES
from nontwist.runfile import read_run_file
from refusals import refused, refused_as, says

C, FAR = np.array([2e-3, 1e-3, 5e-4]), float(np.linalg.norm(CENTRE))
GRAVITIES = {
    "centre": {"mass": MASS, "centre": CENTRE},
    "distance": {"mass": MASS, "distance": FAR},
    "unknown": "unknown",
}
WEIGHT = f"mass={MASS},centre={','.join(map(str, CENTRE))}"
TIMES = np.sort(np.random.default_rng(4).uniform(0, 1.0, 30))


SAT = np.array([[2.0e-4, 1e-5, -5e-6], [1e-5, 2.4e-4, 8e-6], [-5e-6, 8e-6, 3.0e-4]])
WHEEL = 8.4e-6
AXLE = {"axis": "z", "inertia": WHEEL, "speed": 0}
SPINS = np.array([[0, 0.3, 0.6, 1.0], [100, 120, 150, 150]])  # s, rad/s


@cache
def spun():
    """Times, angular velocities and wheel speeds of a free body with a wheel that spins up."""
    rng = np.random.default_rng(0)
    load = nt.rotor("z", SPINS[0], WHEEL * SPINS[1])
    recording = recorded(nt.standard(SAT), 1, (3, -4, 5), load=load, sensor=off_by(rng))
    time = recording.time.values
    return time, recording.gyroscope.values, np.interp(time, *SPINS) + rng.normal(size=len(time))


@cache
def swing(seed=0, seconds=1.0, drag=0.0):
    """What a gyroscope reads of a body that is let go at 80° and turns."""
    how = {"rotation": Rotation.from_euler("x", 80, degrees=True)} | ({"load": nt.damping(drag * C)} if drag else {})
    sensor = {"rate": 100, "seed": seed} | off_by(np.random.default_rng(seed))
    return recorded(nt.heavy_top(J, MASS, CENTRE), seconds, (2, -3, 6), sensor=sensor, **how)


@cache
def fitted(known):
    return nt.fit_inertia(swing(), gravity=GRAVITIES[known])


def by_scipy(inertia, arm, drag, start, times):
    """Angular velocities, directions of gravity and quaternions, by SciPy."""
    inverse = np.linalg.inv(inertia)

    def slope(t, x):
        w, g, v, s = x[:3], x[3:6], x[6:9], x[9]
        moment = np.cross(inertia @ w, w) + np.cross(arm, g) - drag * w
        turned = 0.5 * np.append(s * w + np.cross(v, w), -v @ w)
        return np.concatenate([inverse @ moment, np.cross(g, w), turned])

    return solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-14).y.T


@pytest.mark.filterwarnings("ignore:.*gaps longer")
@pytest.mark.parametrize(
    ("inertia", "seed", "count", "seconds", "speed", "noise", "how"),
    [
        (J, 0, 400, 2, 7, 1e-3, {"gravity": GRAVITIES["centre"]}),
        (np.diag([0.24, 0.38, 0.38]), 2, 150, 2, 5, 8e-3, {"bias": 0.2}),  # no disc that has a bias
        (np.diag([0.312, 0.344, 0.344]), 6, 800, 1, 4, 2e-4, {"bias": 0.005, "noise": 2e-4}),
    ],
)
def test_short_arcs_at_random_times(inertia, seed, count, seconds, speed, noise, how):
    """Of a motion by SciPy from a random W of this size; about a pivot, and of round bodies."""
    rng = np.random.default_rng(seed)
    times, W = np.append(0, np.sort(rng.uniform(0, seconds, count - 1))), rng.normal(size=3)
    begun = [*W * speed / np.linalg.norm(W), 0.6, 0, -0.8, 0, 0, 0, 1]
    W = by_scipy(inertia, ("gravity" in how) * 9.81 * MASS * CENTRE, 0.0, begun, times)[:, :3]
    assert farthest(whole((times, W + noise * rng.normal(size=W.shape)), **how), inertia) < 4


def test_unlikely_gyroscope_error():
    recording = recorded(nt.standard(FREE), 2, (3, -4, 5), sensor={"bias": (0.05, 0, 0)})
    with pytest.warns(UserWarning, match="an error of the gyroscope is 9.9. times its"):
        whole(recording, bias=0.005)
    whole(recording, bias=0.05)


# The model


BEGUN = np.array([2.0, -3, 6, 0.6, 0, -0.8, 0.1, 0.3, -0.2, 0.9])  # W, γ and a quaternion


@pytest.mark.parametrize("acts", [False, True])
def test_motions_are_those_of_scipy(acts):
    """And their derivatives those of complex steps."""
    n, drag, unit = CENTRE / FAR, C / 0.05, 0.05
    more = {"pivot": Pivot(MASS, FAR, None, 9.81), "damping": 3} if acts else {}
    taken, arm = slice(None) if acts else [0, 1, 2, 6, 7, 8, 9], acts * MASS * 9.81 * FAR / unit
    motion = Motion(Model(**more, oriented=True, unit=unit), J / unit, np.concatenate([n, drag])[: 6 * acts])
    ((found, D),) = responses(motion, [Track(BEGUN[taken], TIMES)])
    assert abs(found - by_scipy(J / unit, arm * n, acts * drag, BEGUN, TIMES)[:, taken]).max() < 1e-9 * 7
    columns = [*np.arange(10)[taken], *range(10, 22 if acts else 16)]
    way = np.zeros(22)  # in which all of them change, each as much
    way[columns] = np.random.default_rng(2).normal(size=len(columns)) / abs(D).max(axis=(0, 1))
    e = 1e-30j * way
    given = J / unit + 1j * symmetric(e[10:16].imag), arm * (n + e[16:19]), acts * (drag + e[19:])
    true = by_scipy(*given, BEGUN + e[:10], TIMES).imag[:, taken] / 1e-30
    assert abs(D @ way[columns] - true).max() < 1e-8 * abs(true).max()


def test_free_motion_keeps_invariants():
    track = Track(np.array([8.0, 9, -7]), np.linspace(0, 60, 50))
    ((found, _),) = responses(Motion(Model(), FREE, np.zeros(0)), [track])
    for value in (np.einsum("ni,ij,nj->n", found, FREE, found), np.linalg.norm(found @ FREE, axis=1)):
        assert abs(value / value[0] - 1).max() < 1e-9


def test_tracks_in_lanes():
    motion = Motion(Model(wheel=Wheel(None, WHEEL, 0.0), unit=7e-4), SAT / 7e-4, np.array([0.1, 0.6, 0.8]))
    bent = Line(np.array([0.3, 0.6]), np.full(3, 50.0), np.eye(3), 100.0, np.zeros(3))
    straight = Line(np.zeros(0), np.full(1, 50.0), np.ones((1, 3)), 100.0, np.zeros(3))
    tracks = [Track(BEGUN[:3], TIMES, line) for line in (bent, straight)]
    (x, D), (y, E) = both = responses(motion, tracks)
    for one, found in zip(tracks, both, strict=True):
        ((values, by),) = responses(motion, [one])
        assert (values == found[0]).all()
        assert (by == found[1]).all()
    assert abs(x - y).max() < 1e-9 * 7  # as to SciPy, as steps are others
    assert abs(D[:, :, :12] - E[:, :, :12]).max() < 1e-8 * abs(E).max()
    assert abs(D[:, :, 12:].sum(axis=2) - E[:, :, 12]).max() < 1e-8 * abs(E).max()
    assert (D[TIMES < 0.3, :, 13:] == 0).all()
    assert (D[-1, :3, 12:] != 0).all()


def test_sufficient_cost_ends_a_fit():
    solution = fitted("centre").solution
    start, enough = replace(solution.unknowns, starts=solution.unknowns.starts + 0.05), solution.cost + 1
    found = solve(solution.problem, start, enough=enough)
    assert solution.cost < found.cost < enough
    assert not found.is_settled
    assert solve(solution.problem, start).is_settled


TILT = 0.01
KNOWN = Pivot(0.01, 0.02, np.array([0, 0.6, 0.8]), 9.81)
ALL = {"pivot": Pivot(0.5, 0.15, None, 9.81), "damping": 1, "unit": 0.05}
HELD = {"pivot": KNOWN, "damping": 1, "constraint": np.array([0.0, 0.8, 0.6]), "unit": 6e-4}


ACTING = [
    {},
    {"pivot": Pivot(MASS, FAR, None, 9.81), "damping": 3, "unit": 0.05},
    {**ALL, "wheel": Wheel(np.array([0, 0.6, 0.8]), 1e-3, 0.1)},
    {**HELD, "wheel": Wheel(np.array([0.6, 0.0, 0.8]), WHEEL, 0.01)},
    {**HELD, "wheel": Wheel(None, WHEEL, 0.01)},
]
READ = [("none", []), ("both", range(4, 11)), ("both", [5, 10]), ("only", []), ("none", [7, 8])]
MIXED = [  # each with one of the others in the quick suite
    pytest.param(acting, places, attitudes, marks=[pytest.mark.long] if i != j else [])
    for i, acting in enumerate(ACTING)
    for j, (attitudes, places) in enumerate(READ)
]


@pytest.mark.parametrize(("acting", "places", "attitudes"), MIXED)
def test_residual_derivatives_by_differences(acting, places, attitudes):
    model, rng = Model(**acting, oriented=attitudes != "none"), np.random.default_rng(0)
    time, rates, speeds = (one[::14] for one in spun())
    speed = None
    if model.wheel:
        speed = as_speed(time, np.full(len(time), 40.0) if model.wheel.inertia == 1e-3 else speeds)
    begun = np.tile([0.1, 0.2, -0.4, 0.7], (len(time), 1)) if model.oriented else None
    stretch = Stretch(time, rates, speed, begun, attitudes != "only")
    lanes = short(model, [stretch])
    assert [one.joined for one in lanes] == [True] * (len(lanes) - 1) + [False]
    assert len(lanes) > 1
    deviation = np.append([0.02] * 4, np.isin(range(4, 11), places) * 0.1)
    mean = np.array([0, 0, 0, 1, 0.1, 0.4, -0.2, 0.9, 1.1, 1.2, 0.004]) if places else IDEAL
    problem = Shooting([stretch], Gyroscope(mean, deviation), 1e-2, model, "linear", lanes, TILT)
    beside = {"centre": [0.1, -0.2, 0.97], "axis": [0.5, 0.2, 0.9], "factor": [1.01], "damping": [0.02, 0.03, 0.01]}
    more = np.concatenate([[], *(beside[name][: at.stop - at.start] for name, at in model.places.items())])
    starts = np.hstack([rates[[one.first for one in lanes]], rng.normal(size=(len(lanes), model.size - 3))])
    spins = np.zeros(0) if speed is None else speed.values + 0.1
    at = Unknowns(SAT / np.trace(SAT), more, mean[problem.gyroscope.free] + 0.01, starts, spins)
    if model.oriented:  # away from the recorded attitudes, so that the second order of T counts
        own, moved = slice(model.size - 4, model.size), zip(lanes, problem.motions(at), strict=True)
        q = Rotation.from_quat(np.concatenate([x[: one.last - one.first, own] for one, (x, _) in moved]))
        recorded = (q * Rotation.from_rotvec([0.1, -0.2, 0.1])).as_quat()
        recorded[5] = np.nan
        problem = replace(problem, stretches=[replace(stretch, quaternions=recorded)])
    found, true = differences(problem, at)
    assert len(problem) == 3 * (len(time) * (attitudes != "only") + (len(time) - 1) * model.oriented)
    rows = np.linalg.norm(found, axis=1)[:, None] * model.oriented
    assert (abs(found - true) < 2e-3 * rows + 1e-6 * np.maximum(abs(found).max(axis=0), 1)).all()


@pytest.mark.parametrize("direction", [None, CENTRE / FAR])
def test_weak_form_on_clean_recordings(direction):
    times, down = np.arange(600) / 400, np.array([0.6, 0.0, -0.8])
    rates = by_scipy(J, MASS * 9.81 * CENTRE, C[1], BEGUN, times)[:, :3]
    found = with_moments([(times, rates)], Model(Pivot(MASS, FAR, direction, 9.81), damping=1), 2.0, 0.0)
    assert abs(found.inertia * found.model.unit - J).max() < 1e-4
    assert found.more[-1] * found.model.unit == pytest.approx(C[1], rel=0.02)
    sign = 1 if direction is not None else -1  # the largest component of a direction that is fitted is positive
    np.testing.assert_allclose(sign * found.downs[0], down, atol=1e-3)
    if direction is None:
        np.testing.assert_allclose(sign * found.more[:3], CENTRE / FAR, atol=1e-3)


def test_linear_methods_on_clean_recordings():
    for times in (np.arange(30) / 5, np.arange(400) / 400):  # at first 2.8 rad from sample to sample
        rates = by_scipy(FREE, np.zeros(3), 0, np.array([8.0, 9, -7, 0, 0, 0, 0, 0, 0, 0]), times)[:, :3]
        assert abs(pencil([(times, rates)]) - FREE).max() < 0.01  # half a degree of its search
    found = with_moments([(times, rates)], Model(), 2.0, 0.0)
    assert abs(found.inertia - FREE).max() < 1e-4
    assert found.misfit < 1e-4


# Estimates


@pytest.mark.parametrize("known", GRAVITIES)
def test_pivoted_body_in_kilograms(known):
    fit = fitted(known)
    unit = MASS * FAR if known == "unknown" else 1.0
    assert fit.unit == ("m" if known == "unknown" else "kg m²")
    assert farthest(fit, J / unit) < 4
    assert (len(fit.identifiable), fit.untold) == (6, ())
    n, tilt = fit.centre
    sign = np.sign(n @ CENTRE)
    assert np.linalg.norm(sign * n - CENTRE / FAR) < 2 * tilt + 1e-12
    assert (tilt == 0) == (known == "centre")
    assert apart(fit) < 1e-6
    table = fit.table()
    assert ("does not determine the sign" in table["centre of mass"]) == (known != "centre")
    assert ("as given" in table["centre of mass"]) == (known == "centre")
    assert table["scale"].startswith("neither mass nor" if known == "unknown" else "by the known moment of gravity")
    assert re.search(r" rad/s, correlation of neighbours -?\d\.\d\d, white$", table["residual"])
    assert re.search(r"^\d+ samples, t = \S+ s to \S+ s \(.+\)$", table[fit.parts[0].name])
    if known == "unknown":
        np.testing.assert_allclose(fitted("distance").inertia / unit, fit.inertia, atol=1e-7)


def test_arcs_are_joined_by_twos():
    sensor = {"noise": 3e-4, "rate": 200, "seed": 2}
    rotation = Rotation.random(rng=1)
    recording = recorded(nt.heavy_top(J, MASS, CENTRE), 4, (5.53, 2.22, -8.77), rotation=rotation, sensor=sensor)
    fit = whole(recording, gravity=GRAVITIES["unknown"])
    assert farthest(fit, J / MASS / FAR) < 4


def test_unexplained_fit_is_not_done(here):
    recording = swing(drag=0.3)  # that the model does not have
    with says(UserWarning):
        fit = nt.fit_inertia(recording, gravity=GRAVITIES["centre"])
    assert 10 < fit.misfit < 1.1 * fit.noise / (1.2e-4 * np.sqrt(50))  # over the noise of the sensor
    assert fit.table()["residual"].endswith(" times the noise: not to be trusted")
    csv("swing.csv", HEADER, recording.time, recording.gyroscope)
    how = ["fit", "swing.csv", "--gravity", WEIGHT, "--out", "body.toml"]
    said = ended(3, *how).stderr
    assert "not written: body.toml, because the model does not explain the recordings" in said
    assert not (here / "body.toml").exists()
    ended(0, *how, "--noise", f"{fit.noise:.3g}")


def phone(seed):
    """What a gyroscope reads of a thin plate that hangs by its corner, and its inertia, mass and centre."""
    mass, c, rng = 0.18, np.array([0.036, -0.0735, 0.0]), np.random.default_rng(seed)
    plate = nt.inertia.shift(nt.inertia.of_cuboid(mass, (0.147, 0.072, 0.004)), mass, c)
    start, rotation = 3 * rng.normal(size=3), Rotation.random(rng=rng)
    sensor = {"noise": 5e-3, "rate": 100, "seed": seed} | off_by(rng)
    recording = recorded(nt.heavy_top(plate, mass, c), 1, start, rotation=rotation, sensor=sensor)
    return recording, plate, {"mass": mass, "centre": c}


def test_wall_intervals_are_likelihoods():
    recording, plate, weight = phone(0)
    fit = nt.fit_inertia(recording, gravity=weight)
    solution, wide, true = fit.solution, quantile(fit.solution), np.linalg.eigvalsh(plate)
    start, model, error = solution.unknowns.inertia, solution.problem.model, solution.information.diagonal() ** -0.5
    values, axes = np.linalg.eigh(start)
    squared = np.array([[a[i] * a[j] * (1 if i == j else 2) for i, j in ENTRIES] for a in axes.T])  # by the six entries
    loose = wide * np.sqrt(np.diag(squared @ covariance(fit.told) @ squared.T))

    def body(x):
        return start + symmetric(model.basis @ (error * x))

    def cost(x):
        return (error * x - solution.newton) @ solution.information @ (error * x - solution.newton) / 2

    def thinnest(x):  # second moments beyond those of mass and centre
        return np.linalg.eigvalsh(np.trace(body(x)) / 2 * np.eye(3) - body(x) - model.centred(np.zeros(0)))[0]

    bodies = {"type": "ineq", "fun": lambda x: 1e3 * thinnest(x)}
    how = {"method": "SLSQP", "options": {"ftol": 1e-10, "maxiter": 500}}
    best = minimize(cost, np.zeros(6), constraints=[bodies], **how)
    likely = {"type": "ineq", "fun": lambda x: best.fun + wide**2 / 2 - cost(x)}
    for k, sign in ((0, -1), (1, 1), (2, -1), (2, 1)):
        by = sign * squared[k] / loose[k]
        found = minimize(lambda x, by=by: -by @ entries(body(x) - start), best.x, constraints=[bodies, likely], **how)
        assert found.success
        reach = (fit.principal.intervals[k, (sign + 1) // 2] / fit.size - values[k]) * sign / loose[k]
        assert reach == pytest.approx(-found.fun, abs=0.01)
        assert reach < 1.001
    assert np.diff(fit.principal.intervals)[2, 0] < 0.75 * 2 * loose[2] * fit.size  # the wall counts
    flat = model.nearest(1e-3 * np.eye(3), np.zeros(0))  # where no fit starts, as L has no slope there
    assert model.thinnest(flat, np.zeros(0)) == pytest.approx(1e-4 * 3e-3)
    assert ((fit.principal.intervals[:, 0] < true) & (true < fit.principal.intervals[:, 1])).all()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the fit ended before it settled")  # a few do
def test_wall_intervals_cover():
    covered = []
    for seed in range(100, 180):
        recording, plate, weight = phone(seed)
        (low, high), true = nt.fit_inertia(recording, gravity=weight).principal.intervals.T, np.linalg.eigvalsh(plate)
        covered.append((low < true) & (true < high))
    assert 0.90 < np.mean(covered) < 0.995


def test_damping_is_fitted_or_given():
    three, given = (nt.fit_inertia(swing(drag=1.0), gravity=GRAVITIES["centre"], damping=one) for one in ("three", C))
    for fit in (three, given):
        assert farthest(fit, J) < 4
        assert apart(fit) < 1e-6
    found, intervals = three.damping
    assert (abs(found - C) < np.diff(intervals)[:, 0]).all()
    assert np.diff(intervals).max() < 1e-4
    assert np.array_equal(given.damping[0], C)
    words = [fit.table()["damping"].rpartition(")")[2] for fit in (three, given)]
    assert words == [" N m s", " N m s, as given"]
    still = nt.fit_inertia(swing(1), gravity=GRAVITIES["centre"], damping="one")
    assert still.damping[0].max() < 0  # by noise: no problem has such a damping
    assert not still.problem().load.terms


@cache
def driven():
    return nt.fit_inertia(spun(), rotor=AXLE)


def test_a_rotor_gives_the_scale():
    fit = driven()
    assert fit.unit == "kg m²"
    assert farthest(fit, SAT) < 4
    assert fit.is_white
    assert fit.untold == ()
    assert apart(fit) < 1e-6
    times, speeds = fit.parts[0].speed
    assert abs(np.interp(SPINS[0], times, speeds) - SPINS[1]).max() < 4
    assert re.fullmatch(r"momentum up to 0.00126\S* kg m² s⁻¹; noise of its speed \S+ rad/s", fit.table()["rotor"])
    assert fit.table()["scale"] == "by the known momentum of the rotor; J of the body with the rotor held"
    speedless = {key: AXLE[key] for key in ("axis", "inertia")}
    twice = nt.fit_inertia([spun(), spun()], rotor=speedless)
    assert twice.principal.moments == pytest.approx(fit.principal.moments, rel=0.01)


def test_turn_by_a_radian():
    time, rates, speeds = (one[:30] for one in spun())
    begun = with_moments([(time, rates)], Model(wheel=Wheel(np.eye(3)[2], WHEEL, 0.0)), 2.0, 0.03, [speeds])
    assert begun.model.unit == pytest.approx(np.trace(SAT), rel=0.3)


def test_rotor_axis_is_fitted():
    time, rates, speeds = spun()
    off_axis = []
    for axis, turned in ((np.array([0.0, 0.0, 1.0]), speeds), (np.array([0.0, 0.0, -1.0]), -speeds)):
        fit = nt.fit_inertia((time, rates, turned), rotor=AXLE | {"axis": "fit"})
        found, tilt = fit.rotor_axis
        off_axis.append(np.arccos(found @ axis) / tilt)
        assert farthest(fit, SAT) < 4
    assert f" kg m² s⁻¹ about ({found[0]:.4f}, " in fit.table()["rotor"]
    assert off_axis[0] < 2
    assert off_axis[0] == pytest.approx(off_axis[1], abs=1e-3)
    assert fit.numbers()["rotor_axis_tilt"] == tilt < np.radians(3)
    place, across = fit.solution.problem.model.places["axis"], np.eye(3) - np.outer(found, found)
    widest = np.linalg.norm(across @ fit.solution.beside[place, place] @ across, 2)
    assert tilt == pytest.approx(quantile(fit.solution) * np.sqrt(widest))
    np.testing.assert_allclose(fit.problem().load.terms[0].rotor, found, atol=1e-12)
    assert driven().rotor_axis[1] == 0
    assert np.diff(driven().principal.intervals[0])[0] < np.diff(fit.principal.intervals[0])[0]


@cache
def thrown(pivot=False):
    """Times, angular velocities, wheel speeds and accelerations of a body with a wheel in a hand, free, and caught."""
    time, free, speeds = spun()
    if pivot:
        recording = swing(seconds=2.0)
        time, free, speeds = recording.time.values, recording.gyroscope.values, np.zeros(201)
    rng, rate = np.random.default_rng(3), 1 / time[1]
    away = np.arange(1, int(rate) + 1) / rate

    def hand(W):  # 0.3 s to or from the flight, then about at rest
        near = np.clip(1 - away / 0.3, 0, 1)[:, None]
        wave = sum(rng.normal(size=3) * np.sin(7 * k * away[:, None]) for k in (1, 2, 3, 5))
        return near**2 * (3 - 2 * near) * W + wave * (0.3 + near)

    before, after = hand(free[0])[::-1], hand(free[-1])
    rates = np.concatenate([before, free, after])
    falls = np.repeat([1.0, 0.02, 1.0], [len(before), len(free), len(after)])[:, None] * [0, 0, 9.81]
    return np.arange(len(rates)) / rate, rates, np.pad(speeds, len(away), "edge"), falls


def rubbed():
    """A flight with friction, between two waves of a hand."""
    free = recorded(nt.standard(J), 1.5, (4, -3, 9), load=nt.damping([4e-4] * 3)).gyroscope.values
    steady = np.cos(np.arange(100)[:, None] * [0.05, 0.08, 0.03]) * 2
    return np.arange(501) / 200, np.concatenate([steady, free, steady])


BETWEEN = {  # what is recorded and acts, the inertia, when the free motion begins and ends
    "rotor": (lambda: thrown()[:3], {"rotor": AXLE}, SAT, (1, 2)),
    "file": (thrown, {"rotor": AXLE | {"speed": "wheel (rad/s)"}}, SAT, (1, 2)),
    "pivot": (lambda: thrown(pivot=True)[:2], {"gravity": GRAVITIES["centre"]}, J, (1, 3)),
    "friction": (rubbed, {"damping": "one"}, J / np.trace(J), (0.5, 2)),
}


@pytest.mark.parametrize("case", BETWEEN)
def test_free_motion_between_hands(tmp_path, case):
    source, acting, true, (first, last) = BETWEEN[case]
    given, how = source(), "the smallest residual"
    if case == "file":
        how = "the accelerometer reads almost nothing"
        given = csv(tmp_path / "thrown.csv", f"{HEADER},wheel (rad/s),ax,ay,az", *given)
    fit = nt.fit_inertia(given, **acting)
    (part,) = fit.parts
    assert part.interval == how
    assert first - 0.05 < part.time[0] < first + 0.1
    assert last - 0.1 < part.time[-1] < last + 0.05
    assert farthest(fit, true) < 4
    if case == "friction":
        (c, *_), ((low, high), *_) = fit.damping
        assert low < 4e-4 / np.trace(J) < high < 1.1 * c
        assert fit.table()["damping"].endswith(" s⁻¹, of the sum of the moments")


def test_throw_shorter_than_first_windows():
    """The body turns by 2.4 rad, while hands turn it by 50 rad."""
    away, rng = np.arange(1, 1501) / 1000, np.random.default_rng(1)
    free = recorded(
        nt.standard(SAT), 0.2, (6, -4, 9.6), sensor={"rate": 1000, "noise": 3e-5, "seed": 1}
    ).gyroscope.values
    near = np.clip(1 - away / 0.05, 0, 1)[:, None]
    before, after = (
        near * W + (1 - near) * 16 * np.sin(rng.uniform(8, 25, 3) * away[:, None] + rng.uniform(0, 7, 3))
        for W in (free[0], free[-1])
    )
    rates = np.concatenate([before[::-1], free, after])
    fit = nt.fit_inertia((np.arange(len(rates)) / 1000, rates))
    assert fit.parts[0].time[[0, -1]] == pytest.approx([1.5, 1.7], abs=0.03)
    assert farthest(fit, SAT / np.trace(SAT)) < 4


def test_knots_of_a_speed():
    t = np.linspace(0, 1, 401)
    assert [len(as_speed(t, one).knots) for one in (3 + t, abs(t - 0.25), np.sin(90 * t))] == [2, 17, 65]
    assert [len(as_speed(t[:n], np.sin(90 * t[:n])).knots) for n in (4, 100)] == [2, 33]
    with pytest.raises(ValueError, match="3 readings of the speed are too few"):
        as_speed(t[:3], t[:3])


def test_rotor_error_widens_intervals():
    time, rates, speeds = spun()
    speeds, widths = np.interp(time, *SPINS) + 0.1 * (speeds - np.interp(time, *SPINS)), []
    for error in (0.0, 0.03):
        rotor = AXLE | {"inertia": 1.03 * WHEEL, "error": error, "unit": "rpm"}
        fit = nt.fit_inertia((time, rates, speeds * 30 / np.pi), rotor=rotor)
        low, high = fit.principal.intervals[0]
        widths.append((high - low) / 2 / fit.principal.moments[0])
    assert widths[0] < 0.03
    assert widths[1] == pytest.approx(np.hypot(widths[0], 1.96 * 0.03), rel=0.1)
    assert low < np.linalg.eigvalsh(SAT)[0] < high


def test_nontwisting_body_lacks_one_moment():
    body, rotation = nt.with_gravity(nt.suslov(J, "z"), MASS, CENTRE), Rotation.from_euler("xy", [70, 30], degrees=True)
    recording = recorded(body, 1.5, (1, 3, 0), rotation=rotation, sensor={"bias": (0.01, -0.02, 0.005), "rate": 100})
    fit = nt.fit_inertia(recording, gravity=GRAVITIES["centre"], constraint="z")
    assert np.isnan(fit.inertia[2, 2])
    for (i, j), error in zip(ENTRIES, np.sqrt(fit.covariance.diagonal()), strict=True):
        if (i, j) != (2, 2):
            assert abs(fit.inertia[i, j] - J[i, j]) < 4 * error < 1e-4
    assert (len(fit.identifiable), fit.untold) == (5, ())
    assert fit.table()["Jzz"] == "undetermined"
    assert "n = (0.0000, 0.0000, 1.0000); the moment of inertia about n" in fit.table()["constraint"]
    assert apart(fit) < 1e-6


# What is said


def slender():
    """What a gyroscope reads of a body that is hardly more than a mass at its centre."""
    body = nt.heavy_top(nt.inertia.shift(0.1 * J, MASS, CENTRE), MASS, CENTRE)
    return recorded(body, 1.0, (2, -3, 6), sensor={"rate": 100}, rotation=Rotation.from_euler("x", 80, degrees=True))


def of_swing(**acting):
    return lambda: nt.fit_inertia(swing(), **acting)


test_what_cannot_act_is_refused = refused_as(
    {
        "nothing": of_swing(gravity={}),
        "a mass": of_swing(gravity={"mass": 1}),
        "a centre": of_swing(gravity={"centre": (0, 0, 1)}),
        "no arm": of_swing(gravity={"mass": 1, "centre": (0, 0, 0)}),
        "no mass": of_swing(gravity={"mass": 0, "distance": 1}),
        "a negative distance": of_swing(gravity={"mass": 1, "distance": -1}),
        "an unknown key": of_swing(gravity={"mass": 1, "center": (0, 0, 1)}),
        "centre and distance": of_swing(gravity={"mass": 1, "centre": (0, 0, 1), "distance": 1}),
        "a number": of_swing(gravity=9.81),
        "an unknown damping": of_swing(damping="two"),
        "a negative damping": of_swing(damping=-1),
        "damping without a scale": of_swing(damping=1e-3),
        "no axis": of_swing(gravity="unknown", constraint=(0, 0, 0)),
        "an axis alone": of_swing(constraint="z"),
        "a wrong distance": lambda: nt.fit_inertia(slender(), gravity={"mass": MASS, "distance": 1.2 * FAR}),
        "another centre": lambda: nt.fit_inertia(swing(seconds=0.3), gravity={"mass": MASS, "centre": (0.15, 0, 0)}),
    }
)


def of_spun(columns=3, thin=1, **changed):
    settings = AXLE | changed
    more = {key: settings.pop(key) for key in ("gravity", "misalignment", "interval") if key in settings}
    given = tuple(one[::thin] for one in spun()[:columns])
    return lambda: nt.fit_inertia(given, rotor={k: x for k, x in settings.items() if x is not None}, **more)


test_wrong_rotors = refused_as(
    {
        "no axis": of_spun(axis=(0, 0, 0)),
        "no inertia": of_spun(inertia=0),
        "no speed": of_spun(2, speed=None),
        "an unknown key": of_spun(axes="z"),
        "error": of_spun(error=1),
        "a column of arrays": of_spun(2, speed="erpm"),
        "shapes": lambda: nt.fit_inertia((*spun()[:2], spun()[2][:-1]), rotor=AXLE),
        "a letter": lambda: nt.fit_inertia(spun(), rotor="z"),
        "two scales": of_spun(gravity="unknown"),
        "misaligned": of_spun(axis="fit", speed=0, misalignment="fit"),
        "the other way": of_spun(thin=4, axis="-z", interval="all"),
        "another axis": of_spun(thin=10, axis=(0.6, 0, 0.8), speed=0, interval="all"),
    }
)


@pytest.mark.parametrize(("every", "step", "count"), [(4, 0, 100), (1, 0.5, 400), (1, 10, 400), (400, 0, 400)])
def test_held_readings_of_speed(every, step, count):
    """Each of them counts once; those of a constant speed, or that repeat because they are rounded, all count."""
    times = np.arange(400) / 200
    readings = 300 + 150 * np.sin(3 * times[np.arange(400) // every * every])
    readings = np.round(readings / step) * step if step else readings
    speed = as_speed(times, readings)
    assert len(speed.time) == count
    expected = readings[0] if every == 400 else 300 + 150 * np.sin(3 * times)
    of_lines = 150 * 3**2 * (2 / 32) ** 2 / 8  # between knots; held readings are late by 3.4 rad/s on average
    assert abs(speed.at(times) @ speed.values - expected)[: 401 - every].max() < max(step, of_lines)


def test_columns_without_speed(tmp_path):
    path = csv(tmp_path / "wheel.csv", f"{HEADER},wheel", *spun())
    for code, changed in (
        ("no-column", {"speed": "erpm"}),
        ("no-speed-unit", {"speed": "wheel"}),
        ("speed-unit", {"speed": "wheel", "unit": "Hz"}),
        ("speed-unit", {"speed": 500, "unit": "Hz"}),
        ("speed-unit-stated", {"speed": "gx (rad/s)", "unit": "rpm"}),
    ):
        with refused(code):
            nt.fit_inertia(path, rotor=AXLE | changed)


def test_the_command(here):
    recording, (time, rates, speeds) = swing(drag=1.0), spun()
    csv("swing.csv", HEADER, recording.time, recording.gyroscope)
    csv("wheel.csv", f"{HEADER},wheel", time, rates, speeds * 30 / np.pi)
    wheel = f"axis=0,0,1,inertia={WHEEL},speed=wheel,unit=rpm,error=0.01"
    out = ["--json", "--out", "body.toml"]
    numbers = json.loads(ended(0, "fit", "wheel.csv", "--rotor", wheel, *out).stdout)
    np.testing.assert_allclose(numbers["inertia"], SAT, atol=1e-5)
    assert "speed of the rotor: wheel, rpm" in numbers["recordings"][0]["read"]
    written = read_run_file("body.toml")
    assert (written.title, [one.kind for one in written.load]) == ("Motion as fitted; the rotor is a load", ["rotor"])
    (here / "body.toml").unlink()
    numbers = json.loads(ended(0, "fit", "swing.csv", "--gravity", WEIGHT, "--damping", "three", *out).stdout)
    assert numbers["unit"] == "kg m²"
    np.testing.assert_allclose(numbers["inertia"], J, atol=1e-4)
    np.testing.assert_allclose(numbers["damping"], C, atol=1e-4)
    written = read_run_file("body.toml")
    assert written.title == "Motion as fitted; the heading at the start is arbitrary"
    assert written.body.kind == "heavy_top"
    for status, wrong, text in (
        (2, "0.5,mass=1", "'0.5' is before the first NAME="),
        (2, "mass=1,mass=2", "mass is set twice"),
        (2, "mass=1,centre=0,a,1", "centre of --gravity must be numbers, got '0,a,1'"),
        (3, "unknwon", "'unknown'; got 'unknwon'"),
    ):
        said = ended(status, "fit", "swing.csv", "--gravity", wrong).stderr
        assert text in " ".join(re.sub("[│╭╮╰╯─]", " ", said).split())


@pytest.mark.parametrize("noise", [3e-4, pytest.param(3e-5, marks=pytest.mark.long)])
def test_rotor_with_a_long_valley(noise):
    own = np.diag([0.00464, 0.00964, 0.013])
    recording = recorded(nt.standard(own), 3, (1, 2, -1.5), load=nt.rotor((0, 0, 1), 0.24), sensor={"noise": noise})
    fit = whole(recording, rotor={"axis": (0, 0, 2), "inertia": 4e-3, "speed": 60 * 30 / np.pi, "unit": "rpm"})
    assert farthest(fit, own) < 4
    assert len(fit.parts[0].speed[0]) == 2


def test_satellite_after_its_thrusters():
    """It nutates by 60 rad as it turns by one. In short windows J along the wheel is open, and with it h's sign."""
    J = np.array([[22, 0.4, -0.3], [0.4, 20.5, 0.2], [-0.3, 0.2, 24.5]])
    axis, time = np.array([1, 2, 2]) / 3, np.arange(901) / 10
    times, moments = np.arange(0, 30.5, 0.5), 0.02 * np.random.default_rng(3).normal(size=(61, 3))
    moments[[0, -1]] = 0
    load = nt.wheel(axis, 0.05, speed=500) + nt.body_moment(times, moments)
    run = nt.simulate(nt.standard(J), times=time, load=load, material_angular_velocity=(0.012, -0.015, 0.018))
    recording = nt.sensors.gyroscope(run, noise=2e-5 / np.sqrt(5), seed=1)
    fit = nt.fit_inertia(recording, rotor={"axis": axis, "inertia": 0.05, "speed": 500})
    assert 30 <= fit.parts[0].time[0] < 31
    assert fit.parts[0].time[-1] == 90
    assert fit.is_explained
    assert farthest(fit, J) < 4
