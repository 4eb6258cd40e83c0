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
from typer.testing import CliRunner

from fit_errors import csv, differences, model_of, off
from nontwist import (
    body_moment,
    damping,
    fit_inertia,
    heavy_top,
    inertia,
    nontwisting,
    rotor,
    sensors,
    simulate,
    standard,
    suslov,
    wheel,
    with_gravity,
)
from nontwist.cli import app
from nontwist.fitting import solving
from nontwist.fitting.bodies import Model, Pivot, Wheel, entries, symmetric
from nontwist.fitting.estimating import short, with_moments
from nontwist.fitting.measuring import IDEAL, Gyroscope, as_speed, constant
from nontwist.fitting.motions import Motion, response
from nontwist.fitting.shooting import Shooting, Stretch, Unknowns, residuals
from nontwist.fitting.telling import covariance, quantile, walled
from nontwist.geometry.tensors import ENTRIES
from nontwist.runfile import read_run_file
from refusals import refused, refused_as

MASS, CENTRE, C = 0.5, np.array([0.03, -0.02, -0.15]), np.array([2e-3, 1e-3, 5e-4])
J = np.array([[0.020, 0.001, -0.0005], [0.001, 0.022, 0.0008], [-0.0005, 0.0008, 0.004]])
FAR = float(np.linalg.norm(CENTRE))
GRAVITIES = {
    "centre": {"mass": MASS, "centre": CENTRE},
    "distance": {"mass": MASS, "distance": FAR},
    "unknown": "unknown",
}
HEADER = "t (s),gx (rad/s),gy (rad/s),gz (rad/s)"
TIMES = np.sort(np.random.default_rng(4).uniform(0, 1.0, 30))


PLAIN = np.diag([0.020, 0.022, 0.004])
SAT = np.array([[2.0e-4, 1e-5, -5e-6], [1e-5, 2.4e-4, 8e-6], [-5e-6, 8e-6, 3.0e-4]])
WHEEL = 8.4e-6
SPINS = np.array([[0, 0.3, 0.6, 1.0], [100, 120, 150, 150]])  # s, rad/s


@cache
def spun(seed=0, start=(3, -4, 5), readings=1.0):
    """Times, angular velocities and wheel speeds of a free body with a wheel that spins up."""
    load = rotor("z", SPINS[0], WHEEL * SPINS[1])
    run = simulate(standard(SAT), t_end=1, step=1 / 400, material_angular_velocity=start, load=load)
    rng = np.random.default_rng(seed)
    how = {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal(), "rate": 200, "seed": seed}
    recording = sensors.gyroscope(run, noise=1.2e-4, **how)
    time = recording.time.values
    return time, recording.gyroscope.values, np.interp(time, *SPINS) + readings * rng.normal(size=len(time))


@cache
def swing(seed=0, seconds=1.0, drag=0.0, start=(2, -3, 6), sensor=None):
    """What a gyroscope reads of a body that is let go at 80° and turns."""
    begin = {"rotation": Rotation.from_euler("x", 80, degrees=True), "material_angular_velocity": start}
    load = {"load": damping(drag * C)} if drag else {}
    run = simulate(heavy_top(J, MASS, CENTRE), t_end=seconds, step=1 / 400, **begin, **load)
    rng = np.random.default_rng(seed if sensor is None else sensor)
    how = {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal(), "rate": 100, "seed": seed}
    return sensors.gyroscope(run, noise=1.2e-4, **how)


@cache
def fitted(known):
    return fit_inertia(swing(), gravity=GRAVITIES[known])


def by_scipy(inertia, arm, drag, start, times):
    """Angular velocities and directions of gravity, of real or complex numbers, by SciPy."""
    inverse = np.linalg.inv(inertia)

    def slope(t, x):
        w, g = x[:3], x[3:]
        return np.concatenate([inverse @ (np.cross(inertia @ w, w) + np.cross(arm, g) - drag * w), np.cross(g, w)])

    return solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-14).y.T


# The model


def test_motions_and_their_derivatives_are_those_of_scipy():
    model = Model(Pivot(MASS, FAR, None, 9.81), damping=3, unit=0.05)
    n, drag, unit = CENTRE / FAR, C / 0.05, 0.05
    start = np.concatenate([[2.0, -3.0, 6.0], [0.6, 0.0, -0.8]])
    found, D = response(Motion(model, J / unit, np.concatenate([n, drag])), start, TIMES)
    arm = MASS * 9.81 * FAR / unit
    assert abs(found - by_scipy(J / unit, arm * n, drag, start, TIMES)).max() < 1e-9 * 7
    for k in (1, 5, 8, 9, 12, 14, 15, 17):
        e = 1e-30j * np.eye(18)[k]
        change = symmetric(e[6:12].imag) * 1j
        true = by_scipy(J / unit + change, arm * (n + e[12:15]), drag + e[15:], start + e[:6], TIMES).imag / 1e-30
        assert abs(D[:, :, k] - true).max() < 1e-8 * abs(true).max()


def test_all_numbers_give_a_body_with_this_mass_and_centre():
    rng, n = np.random.default_rng(2), CENTRE / FAR
    model = Model(Pivot(MASS, FAR, None, 9.81))
    np.testing.assert_allclose(model.inertia(model.cholesky(J, n), n)[0], J, atol=1e-15)
    for v in 0.1 * rng.normal(size=(20, 6)):
        m = rng.normal(size=3)
        m /= np.linalg.norm(m)
        found, slope = model.inertia(v, m)
        pseudo = np.block([[np.trace(found) / 2 * np.eye(3) - found, MASS * FAR * m[:, None]], [MASS * FAR * m, MASS]])
        assert np.linalg.eigvalsh(pseudo)[0] > -1e-15
        for k, e in enumerate(1e-6 * np.eye(9)):
            change = model.inertia(v + e[:6], m + e[6:])[0] - model.inertia(v - e[:6], m - e[6:])[0]
            np.testing.assert_allclose(slope[:, k], entries(change) / 2e-6, atol=1e-9)
    assert model.thinnest(model.nearest(np.diag([1e-3, 1e-3, 1e-3]), n), n) > 0


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
def test_the_derivatives_of_the_residuals_are_those_of_differences(acting, places, attitudes):
    model, rng = Model(**acting, oriented=attitudes != "none"), np.random.default_rng(0)
    time, rates, speeds = (one[::7] for one in spun())
    speed = (
        None if model.wheel is None else constant(time, 40.0) if model.wheel.inertia == 1e-3 else as_speed(time, speeds)
    )
    begun = np.tile([0.1, 0.2, -0.4, 0.7], (len(time), 1)) if model.oriented else None
    stretch = Stretch(time, rates, speed, begun, attitudes != "only")
    lanes = short(model, [stretch])
    assert [one.joined for one in lanes] == [True] * (len(lanes) - 1) + [False]
    deviation = np.full(11, 0.02)
    deviation[4:] = np.isin(range(4, 11), places) * 0.1
    mean = np.array([0, 0, 0, 1, 0.1, 0.4, -0.2, 0.9, 1.1, 1.2, 0.004]) if places else IDEAL
    problem = Shooting([stretch], Gyroscope(mean, deviation), 1e-2, "linear", lanes, model, TILT)
    beside = {"centre": [0.1, -0.2, 0.97], "axis": [0.5, 0.2, 0.9], "factor": [1.01], "damping": [0.02, 0.03, 0.01]}
    more = np.concatenate([[], *(beside[name][: at.stop - at.start] for name, at in model.places.items())])
    count = len(lanes)
    starts = [rates[[one.first for one in lanes]], rng.normal(size=(count, 3 * (model.pivot is not None)))]
    starts += [rng.normal(size=(count, 4))] * model.oriented
    spins = np.zeros(0) if speed is None else speed.values + 0.1
    at = Unknowns(SAT / np.trace(SAT), more, mean[problem.gyroscope.free] + 0.01, np.concatenate(starts, axis=1), spins)
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


def test_speeds_have_as_many_knots_as_they_need():
    time = np.arange(201) / 200
    rng = np.random.default_rng(0)
    assert len(as_speed(time, np.full(201, 3.0) + rng.normal(size=201)).knots) == 2
    bent = as_speed(time, abs(time - 0.5) + 1e-3 * rng.normal(size=201))
    np.testing.assert_allclose(bent.knots, np.linspace(0, 1, 9), atol=1e-12)  # a quarter of the two that it has
    assert bent.noise == pytest.approx(1e-3, rel=0.3)
    assert len(bent.refined().knots) == 17
    holes = np.where(rng.random(201) < 0.2, np.nan, 2 * time)
    np.testing.assert_allclose(as_speed(time, holes).values, [0, 2 * time[-1]], atol=1e-9)


@pytest.mark.parametrize("direction", [None, CENTRE / FAR])
def test_the_weak_form_finds_inertia_arm_and_vertical_of_clean_recordings(direction):
    times, down = np.arange(600) / 400, np.array([0.6, 0.0, -0.8])
    start = np.concatenate([[2.0, -3.0, 6.0], down])
    rates = by_scipy(J, MASS * 9.81 * CENTRE, C[1], start, times)[:, :3]
    model = Model(Pivot(MASS, FAR, direction, 9.81), damping=1)
    found = with_moments([(times, rates)], model, 2.0, 0.0)
    assert abs(found.inertia * found.model.unit - J).max() < 1e-4
    assert found.more[-1] * found.model.unit == pytest.approx(C[1], rel=0.02)
    sign = 1 if direction is not None else -1  # the largest component of a direction that is fitted is positive
    np.testing.assert_allclose(sign * found.downs[0], down, atol=1e-3)
    if direction is None:
        np.testing.assert_allclose(sign * found.more[:3], CENTRE / FAR, atol=1e-3)


# Estimates


@pytest.mark.parametrize("known", ["centre", "distance", "unknown"])
def test_a_pivoted_body_has_its_inertia_in_kilograms_and_metres(known):
    fit = fitted(known)
    unit = MASS * FAR if known == "unknown" else 1.0
    assert fit.unit == ("m" if known == "unknown" else "kg m²")
    assert abs(off(fit, J / unit)).max() < 4
    assert len(fit.identifiable) == 6
    assert fit.untold == ()
    n, tilt = fit.centre
    sign = np.sign(n @ CENTRE)
    assert np.linalg.norm(sign * n - CENTRE / FAR) < 2 * tilt + 1e-12
    assert (tilt == 0) == (known == "centre")
    assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6
    assert ("does not determine the sign" in fit.table()["centre of mass"]) == (known != "centre")
    assert len(fit.plot().figure.axes) == 3


def test_no_step_changes_the_length_of_a_direction(monkeypatch):
    calls = []
    monkeypatch.setattr(solving, "residuals", lambda *given: calls.append(given) or residuals(*given))
    fit_inertia(swing(), gravity=GRAVITIES["centre"])
    assert len(calls) < 60  # otherwise there are more than 100


def test_a_body_that_is_nearly_a_rod_is_found_from_afar():
    # all second moments but those of m c cᵀ are small: a fit that begins on the wall of flat bodies creeps along
    rod = np.array([[14.80621, -0.2835, -0.43257], [-0.2835, 10.64411, -6.44461], [-0.43257, -6.44461, 5.0067]]) / 1000
    mass, c, down = 0.7148, np.array([0.00472923, 0.07622413, 0.11689464]), np.array([0.28743, -0.69938, 0.65440])
    attitude = Rotation.align_vectors([[0, 0, -1]], [down])[0]
    begin = {"rotation": attitude, "material_angular_velocity": (-3.5443, 0.65056, -0.20829)}
    run = simulate(heavy_top(rod, mass, c), t_end=1.5, step=1 / 400, **begin)
    recording = sensors.gyroscope(run, noise=1.2e-4, bias=(0.013, 0.020, 0.044), scale=0.995, rate=400, seed=1)
    fit = fit_inertia(recording, gravity={"mass": mass, "distance": np.linalg.norm(c)})
    assert abs(off(fit, rod)).max() < 4
    assert fit.misfit == pytest.approx(1, abs=0.1)


def test_a_fit_that_noise_and_model_do_not_explain_is_not_done(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = swing(drag=0.3)  # that the model does not have
    said = (
        r"^the residuals are \S+ times what noise explains: neither the inertia nor its intervals are to be trusted. "
        r"Are hands or impacts in it \(--from and --to, interval=\), does more act on the body \(--damping, "
        r"damping=\), does a part move, is the mass, the centre or the unit wrong\? Where the sensor is off by as "
        r"much, --noise \(noise=\) states it$"
    )
    with pytest.warns(UserWarning, match=said):
        fit = fit_inertia(recording, gravity=GRAVITIES["centre"])
    assert 10 < fit.misfit < 1.1 * fit.noise / (1.2e-4 * np.sqrt(50))  # over the noise of the sensor
    assert fit.table()["residual"].endswith(" times the noise: not to be trusted")
    csv("swing.csv", HEADER, recording.time, recording.gyroscope)
    weight = f"mass={MASS},centre={','.join(map(str, CENTRE))}"
    how = ["fit", "swing.csv", "--gravity", weight, "--out", "body.toml"]
    result = CliRunner().invoke(app, how)
    assert result.exit_code == 3
    assert "not written: body.toml, because the model does not explain the recordings" in result.stderr
    assert not (tmp_path / "body.toml").exists()
    assert CliRunner().invoke(app, [*how, "--noise", f"{fit.noise:.3g}"]).exit_code == 0


def phone(seed, noise):
    """What a gyroscope reads of a thin plate that hangs by its corner, and its inertia, mass and centre."""
    mass, c = 0.18, np.array([0.036, -0.0735, 0.0])
    plate = inertia.of_cuboid(mass, (0.147, 0.072, 0.004)) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    rng = np.random.default_rng(seed)
    start = 3 * rng.normal(size=3)
    begin = {"rotation": Rotation.random(rng=rng), "material_angular_velocity": start}
    run = simulate(heavy_top(plate, mass, c), t_end=1, step=1 / 400, **begin)
    how = {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal(), "rate": 100, "seed": seed}
    return sensors.gyroscope(run, noise=noise, **how), plate, {"mass": mass, "centre": c}


def test_intervals_that_meet_the_wall_are_those_of_the_likelihood_of_bodies():
    recording, plate, weight = phone(0, 5e-3)
    fit = fit_inertia(recording, gravity=weight)
    solution, wide, C = fit.solution, quantile(fit.solution), covariance(fit.told)
    start, model = solution.unknowns.inertia, solution.problem.model
    values, axes = np.linalg.eigh(start)
    loose = np.array([wide * np.sqrt(product @ C @ product) for product in _squared(axes)])
    m, error = solution.newton, np.sqrt(1 / solution.information.diagonal())

    def inertia(x):
        return start + symmetric(model.basis @ (error * x))

    def cost(x):
        return (error * x - m) @ solution.information @ (error * x - m) / 2

    def thinnest(x):  # second moments beyond those of mass and centre
        second = np.trace(inertia(x)) / 2 * np.eye(3) - inertia(x) - model.centred(np.zeros(0))
        return 1e3 * np.linalg.eigvalsh(second)[0]

    body = {"type": "ineq", "fun": thinnest}
    best = minimize(cost, np.zeros(6), method="SLSQP", constraints=[body], options={"ftol": 1e-10, "maxiter": 500})
    near = {"type": "ineq", "fun": lambda x: best.fun + wide**2 / 2 - cost(x)}
    for k, by in enumerate(_squared(axes)):
        for end, sign in enumerate((-1, 1)):

            def moment(x, by=by, sign=sign, k=k):
                return -sign * by @ entries(inertia(x) - start) / loose[k]

            found = minimize(
                moment, best.x, method="SLSQP", constraints=[body, near], options={"ftol": 1e-10, "maxiter": 500}
            )
            assert found.success
            reach = (fit.principal.intervals[k, end] / fit.size - values[k]) * sign / loose[k]
            assert reach == pytest.approx(-found.fun, abs=0.01)
            assert reach < 1.001
    assert np.diff(fit.principal.intervals)[2, 0] < 0.75 * 2 * loose[2] * fit.size  # the wall counts
    assert (fit.principal.intervals[:, 0] < np.linalg.eigvalsh(plate)).all()
    assert (np.linalg.eigvalsh(plate) < fit.principal.intervals[:, 1]).all()


def _squared(axes):
    """Derivatives of the principal moments by the six entries."""
    return np.array([[a[i] * a[j] * (1 if i == j else 2) for i, j in ENTRIES] for a in axes.T])


def test_a_fast_swing_is_found_by_arcs_that_are_joined_two_by_two():
    # a whole recording from the start of its first arc ends nowhere near
    recording, plate, weight = phone(132, 5e-3)
    fit = fit_inertia(recording, gravity=weight)
    assert abs(off(fit, plate)).max() < 4
    assert fit.misfit == pytest.approx(1, abs=0.2)


def test_far_from_the_wall_the_likelihood_of_bodies_is_normal():
    solution = fitted("centre").solution
    wide, C = quantile(solution), covariance(fitted("centre").told)
    for by in _squared(np.linalg.eigh(solution.unknowns.inertia)[1]):
        error = wide * np.sqrt(by @ C @ by)
        for sign in (-1, 1):
            assert walled(solution, by, sign, wide) == pytest.approx(sign * error, rel=2e-3)


@pytest.mark.long
def test_intervals_at_the_wall_cover_the_truth():
    covered = []
    for seed in range(100, 180):
        recording, plate, weight = phone(seed, 5e-3)
        found = fit_inertia(recording, gravity=weight).principal.intervals
        covered.append((found[:, 0] < np.linalg.eigvalsh(plate)) & (np.linalg.eigvalsh(plate) < found[:, 1]))
    assert 0.90 < np.mean(covered) < 0.995


def test_the_ratio_to_the_arm_is_the_inertia_over_it():
    known, unknown = fitted("distance"), fitted("unknown")
    np.testing.assert_allclose(known.inertia / (MASS * FAR), unknown.inertia, atol=1e-7)


@pytest.mark.long
def test_errors_about_a_pivot_are_as_large_as_the_intervals_say():
    rng = np.random.default_rng(3)
    deviations = []
    for seed in range(6):
        recording = swing(seed + 10, start=tuple(4 * rng.normal(size=3)))
        deviations.append(off(fit_inertia(recording, gravity=GRAVITIES["centre"]), J))
    assert abs(np.array(deviations)).max() < 4
    assert 0.4 < np.sqrt(np.mean(np.square(deviations))) < 1.6


def test_damping_is_fitted_or_given():
    recording = swing(drag=1.0)
    three = fit_inertia(recording, gravity=GRAVITIES["centre"], damping="three")
    given = fit_inertia(recording, gravity=GRAVITIES["centre"], damping=C)
    for fit in (three, given):
        assert abs(off(fit, J)).max() < 4
        assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6
    found, intervals = three.damping
    assert (abs(found - C) < np.diff(intervals)[:, 0]).all()
    assert np.diff(intervals).max() < 1e-4
    assert np.array_equal(given.damping[0], C)


def test_a_free_body_with_damping_tells_its_rate():
    run = simulate(standard(J), t_end=1.0, step=1 / 400, material_angular_velocity=(2, -5, 6), load=damping(1e-3))
    fit = fit_inertia(sensors.gyroscope(run, noise=1.2e-4, rate=200), damping="one")
    (c, *_), ((low, high), *_) = fit.damping
    assert low < 1e-3 / np.trace(J) < high < 1.1 * c
    assert abs(off(fit, J / np.trace(J))).max() < 4
    assert fit.table()["damping"].endswith(" s⁻¹, of the sum of the moments")


def test_several_swings_together():
    recordings = [swing(seed, start=start, sensor=9) for seed, start in enumerate([(2, -3, 6), (-4, 1, 3)])]
    fit = fit_inertia(recordings, gravity=GRAVITIES["distance"])
    assert abs(off(fit, J)).max() < 4
    assert abs(fit.cross_validation - 1).max() < 0.3


def test_a_swing_in_a_plane_tells_one_moment():
    body = heavy_top(np.diag([0.02, 0.022, 0.004]), MASS, (0, 0, -0.15))
    run = simulate(body, t_end=1, step=1 / 400, rotation=Rotation.from_euler("x", 60, degrees=True))
    recording = sensors.gyroscope(run, noise=1.2e-4, rate=100)
    with pytest.warns(UserWarning, match="^the recording does not determine "):
        fit = fit_inertia(recording, gravity={"mass": MASS, "centre": (0, 0, -0.15)})
    assert fit.inertia[0, 0] == pytest.approx(0.02, rel=1e-3)
    assert np.isnan(fit.inertia[1:, 1:]).all()
    assert len(fit.untold) == 3
    with pytest.raises(ValueError, match="does not determine the whole inertia"):
        fit.problem()


def test_a_rotor_gives_the_scale():
    fit = fit_inertia(spun(), rotor={"axis": "z", "inertia": WHEEL, "speed": 0})
    assert fit.unit == "kg m²"
    assert abs(off(fit, SAT)).max() < 4
    assert fit.is_white
    assert fit.untold == ()
    assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6
    times, speeds = fit.parts[0].speed
    assert abs(np.interp(SPINS[0], times, speeds) - SPINS[1]).max() < 4
    assert "momentum up to 0.0013" in fit.table()["rotor"] or "momentum up to 0.0012" in fit.table()["rotor"]


def test_the_axis_of_a_rotor_is_fitted():
    time, rates, speeds = spun()
    off_axis = []
    for axis, turned in ((np.array([0.0, 0.0, 1.0]), speeds), (np.array([0.0, 0.0, -1.0]), -speeds)):
        fit = fit_inertia((time, rates, turned), rotor={"axis": "fit", "inertia": WHEEL, "speed": 0})
        found, tilt = fit.rotor_axis
        off_axis.append(np.arccos(found @ axis) / tilt)
        assert abs(off(fit, SAT)).max() < 4
    assert off_axis[0] < 2
    assert off_axis[0] == pytest.approx(off_axis[1], abs=1e-3)
    assert tilt < np.radians(3)
    place, across = fit.solution.problem.model.places["axis"], np.eye(3) - np.outer(found, found)
    widest = np.linalg.norm(across @ fit.solution.beside[place, place] @ across, 2)
    assert tilt == pytest.approx(quantile(fit.solution) * np.sqrt(widest))
    assert fit.numbers()["rotor_axis_tilt"] == tilt
    np.testing.assert_allclose(fit.problem().load.terms[0].rotor, found, atol=1e-12)
    given = fit_inertia(spun(), rotor={"axis": "z", "inertia": WHEEL, "speed": 0})
    assert given.rotor_axis[1] == 0
    assert np.diff(given.principal.intervals[0])[0] < np.diff(fit.principal.intervals[0])[0]


@cache
def thrown(pivot=False):
    """Times, angular velocities, wheel speeds and accelerations of a body with a wheel in a hand, free, and caught."""
    if pivot:
        recording = swing(seconds=2.0)
        time, free, speeds = recording.time.values, recording.gyroscope.values, np.zeros(201)
    else:
        time, free, speeds = spun()
    rng, rate = np.random.default_rng(3), 1 / time[1]
    away = np.arange(1, int(rate) + 1) / rate

    def hand(W):  # 0.3 s to or from the flight, then about at rest
        near = np.clip(1 - away / 0.3, 0, 1)[:, None]
        wave = sum(rng.normal(size=3) * np.sin(7 * k * away[:, None]) for k in (1, 2, 3, 5))
        return near**2 * (3 - 2 * near) * W + wave * (0.3 + near)

    before, after = hand(free[0])[::-1], hand(free[-1])
    rates = np.concatenate([before, free, after])
    falls = np.repeat([1.0, 0.02, 1.0], [len(before), len(free), len(after)])[:, None] * [0, 0, 9.81]
    ends = np.full(len(away), speeds[0]), np.full(len(away), speeds[-1])
    return np.arange(len(rates)) / rate, rates, np.concatenate([ends[0], speeds, ends[1]]), falls


def test_the_flight_of_a_body_with_a_rotor_is_found(tmp_path):
    time, rates, speeds, falls = thrown()
    wheel = {"axis": "z", "inertia": WHEEL}
    path = csv(tmp_path / "thrown.csv", f"{HEADER},wheel (rad/s),ax,ay,az", time, rates, speeds, falls)
    for source, speed, how in (
        ((time, rates, speeds), 0, "the smallest residual"),
        (path, "wheel (rad/s)", "the accelerometer reads almost nothing"),
    ):
        fit = fit_inertia(source, rotor=wheel | {"speed": speed})
        (part,) = fit.parts
        assert part.interval == how
        assert 0.99 <= part.time[0] <= 1.05
        assert 1.95 <= part.time[-1] <= 2.01
        assert abs(off(fit, SAT)).max() < 4


def test_the_swing_about_a_pivot_is_found():
    time, rates, _, _ = thrown(pivot=True)
    fit = fit_inertia((time, rates), gravity=GRAVITIES["centre"])
    assert 0.98 <= fit.parts[0].time[0] <= 1.1
    assert 2.9 <= fit.parts[0].time[-1] <= 3.02
    assert abs(off(fit, J)).max() < 4


def test_the_flight_with_friction_is_found():
    how = {"material_angular_velocity": (4, -3, 9), "load": damping([4e-4] * 3)}
    recording = sensors.gyroscope(simulate(standard(J), t_end=1.5, step=1 / 400, **how), noise=1.2e-4, rate=200)
    steady = np.cos(np.arange(100)[:, None] * [0.05, 0.08, 0.03]) * 2  # a hand
    fit = fit_inertia(
        (np.arange(501) / 200, np.concatenate([steady, recording.gyroscope.values, steady])), damping="one"
    )
    assert abs(off(fit, J / np.trace(J))).max() < 4
    assert abs(fit.parts[0].time[0] - 0.5) < 0.05
    assert abs(fit.parts[0].time[-1] - 2.0) < 0.05


def test_the_error_of_a_rotor_is_in_the_intervals():
    time, rates, speeds = spun(readings=0.1)
    widths = []
    for error in (0.0, 0.03):
        fit = fit_inertia((time, rates, speeds), rotor={"axis": "z", "inertia": 1.03 * WHEEL, "error": error})
        low, high = fit.principal.intervals[0]
        widths.append((high - low) / 2 / fit.principal.moments[0])
    assert widths[0] < 0.03
    assert widths[1] == pytest.approx(np.hypot(widths[0], 1.96 * 0.03), rel=0.1)
    assert low < np.linalg.eigvalsh(SAT)[0] < high


def test_a_constant_speed_is_a_number():
    load = rotor((0, 0, 1), WHEEL * 150)
    run = simulate(standard(SAT), t_end=1, step=1 / 400, material_angular_velocity=(3, -4, 5), load=load)
    recording = sensors.gyroscope(run, noise=1.2e-4, rate=200)
    fit = fit_inertia(recording, rotor={"axis": (0, 0, 2), "inertia": WHEEL, "speed": 150})
    assert abs(off(fit, SAT)).max() < 4
    assert len(fit.parts[0].speed[0]) == 2


def test_a_rotor_nutates_a_body_that_hardly_turns():
    """A satellite with a momentum wheel, h = 60 |J W|: SciPy's motion goes on by 60 rad while it turns by one."""
    J = np.array([[20.0, 1.0, -0.5], [1.0, 25.0, 0.8], [-0.5, 0.8, 18.0]])
    axis, time = np.array([0.6, 0.0, 0.8]), np.arange(0, 60, 0.1)

    def slope(t, w):
        return np.linalg.solve(J, np.cross(J @ w + 25.0 * axis, w))

    W = solve_ivp(slope, (0, 60), (0.012, -0.016, 0.004), "DOP853", time, rtol=1e-12, atol=1e-14).y.T
    rates = W + 2e-5 * np.random.default_rng(3).normal(size=W.shape)
    for known in (axis, "fit"):
        fit = fit_inertia((time, rates), rotor={"axis": known, "inertia": 0.05, "speed": 500})
        assert fit.untold == ()
        assert fit.is_explained
        assert abs(off(fit, J)).max() < 4


@pytest.mark.parametrize("make", [lambda: nontwisting(PLAIN), lambda: suslov(J, "z")])
def test_a_body_that_may_not_twist_has_all_of_its_inertia_but_about_that_axis(make):
    body = make()
    true, centre = (J, CENTRE) if body.name == "suslov" else (PLAIN, np.array([0, 0, -0.15]))
    begin = {"rotation": Rotation.from_euler("xy", [70, 30], degrees=True), "material_angular_velocity": (1, 3, 0)}
    run = simulate(with_gravity(body, MASS, centre), t_end=1.5, step=1 / 400, **begin)
    recording = sensors.gyroscope(run, noise=1.2e-4, bias=(0.01, -0.02, 0.005), scale=1.004, rate=100)
    fit = fit_inertia(recording, gravity={"mass": MASS, "centre": centre}, constraint="z")
    errors = np.sqrt(fit.covariance.diagonal())
    assert np.isnan(fit.inertia[2, 2])
    for (i, j), error in zip(ENTRIES, errors, strict=True):
        if (i, j) != (2, 2):
            assert abs(fit.inertia[i, j] - true[i, j]) < 4 * error < 1e-4
    assert (len(fit.identifiable), fit.untold) == (5, ())
    assert fit.table()["Jzz"] == "undetermined"
    assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6


# What is said


def of_swing(**acting):
    return lambda: fit_inertia(swing(), **acting)


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
        "another centre": of_swing(gravity={"mass": MASS, "centre": (0.15, 0, 0)}),
    }
)


def of_spun(columns=3, **changed):
    settings = {"axis": "z", "inertia": WHEEL, "speed": 1.0, **changed}
    return lambda: fit_inertia(spun()[:columns], rotor={k: x for k, x in settings.items() if x is not None})


test_rotors_that_are_none_are_refused = refused_as(
    {
        "no axis": of_spun(axis=(0, 0, 0)),
        "no inertia": of_spun(inertia=0),
        "no speed": of_spun(2, speed=None),
        "an unknown key": of_spun(axes="z"),
        "error": of_spun(error=1),
        "a column of arrays": of_spun(2, speed="erpm"),
        "shapes": lambda: fit_inertia((*spun()[:2], spun()[2][:-1]), rotor={"axis": "z", "inertia": WHEEL, "speed": 1}),
        "a letter": lambda: fit_inertia(spun(), rotor="z"),
        "two scales": lambda: fit_inertia(spun(), rotor={"axis": "z", "inertia": WHEEL, "speed": 1}, gravity="unknown"),
        "misaligned": lambda: fit_inertia(
            spun(), rotor={"axis": "fit", "inertia": WHEEL, "speed": 0}, misalignment="fit"
        ),
        "the other way": lambda: fit_inertia(thrown()[:3], rotor={"axis": "-z", "inertia": WHEEL, "speed": 0}),
        "another axis": lambda: fit_inertia(
            spun(), rotor={"axis": (0.6, 0, 0.8), "inertia": WHEEL, "speed": 0}, interval="all"
        ),
    }
)


@pytest.mark.parametrize(
    ("code", "changed"),
    [
        ("no-column", {"speed": "erpm"}),
        ("no-speed-unit", {"speed": "wheel"}),
        ("speed-unit", {"speed": "wheel", "unit": "Hz"}),
        ("speed-unit-stated", {"speed": "gx (rad/s)", "unit": "rpm"}),
    ],
)
def test_columns_that_are_no_speed_are_refused(tmp_path, code, changed):
    path = csv(tmp_path / "wheel.csv", f"{HEADER},wheel", *spun())
    with refused(code):
        fit_inertia(path, rotor={"axis": "z", "inertia": WHEEL, **changed})


def test_the_command_reads_the_speed_of_a_rotor(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, rates, speeds = spun()
    csv("wheel.csv", f"{HEADER},wheel", time, rates, speeds * 30 / np.pi)
    how = f"axis=0,0,1,inertia={WHEEL},speed=wheel,unit=rpm,error=0.01"
    result = CliRunner().invoke(app, ["fit", "wheel.csv", "--rotor", how, "--json", "--out", "body.toml"])
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    np.testing.assert_allclose(numbers["inertia"], SAT, atol=1e-5)
    assert "speed of the rotor: wheel, rpm" in numbers["recordings"][0]["read"]
    assert [one.kind for one in read_run_file("body.toml").load] == ["rotor"]


def test_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recording = swing(drag=1.0)
    csv("swing.csv", HEADER, recording.time, recording.gyroscope)
    weight = f"mass={MASS},centre={','.join(map(str, CENTRE))}"
    runner = CliRunner()
    how = ["fit", "swing.csv", "--gravity", weight, "--damping", "three", "--json", "--out", "body.toml"]
    result = runner.invoke(app, how)
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    assert numbers["unit"] == "kg m²"
    np.testing.assert_allclose(numbers["inertia"], J, atol=1e-4)
    np.testing.assert_allclose(numbers["damping"], C, atol=1e-4)
    assert read_run_file("body.toml").body.kind == "heavy_top"
    for wrong, text in (
        ("0.5,mass=1", "'0.5' is before the first NAME="),
        ("mass=1,mass=2", "mass is set twice"),
        ("mass=1,centre=0,a,1", "centre of --gravity must be numbers, got '0,a,1'"),
    ):
        result = runner.invoke(app, ["fit", "swing.csv", "--gravity", wrong])
        assert result.exit_code == 2
        assert text in " ".join(re.sub("[│╭╮╰╯─]", " ", result.stderr).split())
    result = runner.invoke(app, ["fit", "swing.csv", "--gravity", "unknwon"])
    assert result.exit_code == 3
    assert "'unknown'; got 'unknwon'" in result.stderr


@pytest.mark.parametrize("noise", [3e-4, pytest.param(3e-5, marks=pytest.mark.long)])
def test_a_rotor_of_constant_speed_whose_valley_is_long(noise):
    own = np.diag([0.00464, 0.00964, 0.013])
    how = {"t_end": 3, "step": 1e-3, "material_angular_velocity": (1, 2, -1.5)}
    recording = sensors.gyroscope(simulate(standard(own), load=rotor((0, 0, 1), 0.24), **how), noise=noise, rate=200)
    fit = fit_inertia(recording, rotor={"axis": "z", "inertia": 4e-3, "speed": 60}, interval="all")
    assert abs(off(fit, own)).max() < 4


@pytest.mark.parametrize("size", [0.02, 0.2])
def test_a_satellite_with_a_wheel_is_found_behind_its_thrusters(size):
    """In short windows J along the wheel is open, and with it the sign of its momentum."""
    J = np.array([[22, 0.4, -0.3], [0.4, 20.5, 0.2], [-0.3, 0.2, 24.5]])
    axis, rng, time = np.array([1, 2, 2]) / 3, np.random.default_rng(3), np.arange(901) / 10
    times, moments = np.arange(0, 30.5, 0.5), size * rng.normal(size=(61, 3))
    moments[[0, -1]] = 0
    load = wheel(axis, 0.05, speed=500) + body_moment(times, moments)
    run = simulate(standard(J), times=time, load=load, material_angular_velocity=(0.012, -0.015, 0.018))
    recording = sensors.gyroscope(run, noise=2e-5 / np.sqrt(5), seed=1)
    fit = fit_inertia(recording, rotor={"axis": axis, "inertia": 0.05, "speed": 500})
    first, last = fit.parts[0].time[[0, -1]]
    assert 30 <= first < 31
    assert last == 90
    assert fit.is_explained
    assert abs(off(fit, J)).max() < 4
