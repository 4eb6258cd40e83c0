"""Errors of a gyroscope in fits: delay, misalignment, scales of single axes."""

import json
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from conftest import ended
from fit_errors import CENTRE, MASS, TURNED, begun, csv, farthest, off, off_by, recorded, tilted, whole
from fit_errors import FREE as J
from nontwist import heavy_top, rotation, sensors, simulate, standard
from refusals import refused_as

THETA, SCALES, LATE = np.array([0.03, -0.05, 0.02]), np.array([1.01, 0.985, 1.005]), 0.008
ERRORS = {"misalignment": THETA, "axis_scales": SCALES, "delay": LATE}
FIT = dict.fromkeys(ERRORS, "fit")
TILT = np.radians(0.2)


@cache
def flight(seed=0, rate=200):
    """Times, readings of a gyroscope with errors and attitudes of a thrown body, and J of trace 1."""
    rng = np.random.default_rng(seed)
    run = simulate(standard(J), t_end=1.5, step=1 / rate, **begun(rng, 14))
    read = sensors.gyroscope(run, noise=1.2e-4, seed=seed, rate=rate, **off_by(rng), **ERRORS)
    return read.time.values, read.gyroscope.values, tilted(rotation(run)[-read.sizes["time"] :], TILT, rng), J


def test_readings_follow_the_formula():
    """Against SciPy: Euler's equations at t - τ, then turned, scaled, and with a bias."""
    start, t = np.array([8.0, 9, -7]), 0.3 + np.arange(2, 121) / 200
    run = simulate(standard(J), t_start=0.3, t_end=0.9, step=1 / 200, material_angular_velocity=start)
    read = sensors.gyroscope(run, rate=200, bias=(0.1, 0, -0.2), scale=1.1, **ERRORS)

    def euler(_, W):
        return np.linalg.solve(J, np.cross(J @ W, W))

    W = solve_ivp(euler, (0.3, 0.9), start, "DOP853", t - LATE, rtol=1e-12, atol=1e-13).y.T
    expected = 1.1 * SCALES * Rotation.from_rotvec(THETA).inv().apply(W) + [0.1, 0, -0.2]
    assert read.time.values == pytest.approx(t)
    assert read.gyroscope.values == pytest.approx(expected, abs=1e-7)
    assert read.gyroscope.attrs["units"] == "rad s-1"
    assert np.array_equal(sensors.gyroscope(run).gyroscope.values, run.material_angular_velocity.values)
    assert sensors.gyroscope(run, rate=1 / 0.6).time.values == pytest.approx([0.3, 0.9], abs=1e-15)
    noise = sensors.gyroscope(run, noise=0.02, rate=200).gyroscope - run.material_angular_velocity
    assert noise.std().item() == pytest.approx(0.2, rel=0.1)  # the density of white noise, over half the rate


def errors_off(fit):
    """Return the errors of misalignment and delay in half-widths of their 95 % intervals."""
    (angles, ends), (late, span) = fit.misalignment, fit.delay
    return np.append((angles - THETA) / np.diff(ends)[:, 0], (late - LATE) / np.diff(span)) * 2


def test_attitudes_tell_all_errors():
    """But for the scales: those of single axes and the common one are told as products, within the priors of both."""
    deviations = []
    for seed in (3, 4, 5):
        time, rates, read, body = flight(seed)
        fit = whole((time, rates, read), **FIT)
        assert fit.is_white
        assert fit.is_explained
        deviations.append(np.concatenate([errors_off(fit), off(fit, body / np.trace(body)) / 2]))
    assert abs(np.array(deviations)).max() < 2
    assert 0.25 < np.sqrt(np.mean(np.square(deviations))) < 0.75
    assert fit.delay[1][1] - fit.delay[1][0] < 1e-3


@pytest.mark.parametrize("how", ["given", "a prior"])
def test_known_errors_without_attitudes(how):
    time, rates, _, body = flight()
    given = ERRORS if how == "given" else {name: {"value": x, "error": 1e-3} for name, x in ERRORS.items()}
    fit = whole((time, rates), **given)
    assert farthest(fit, body / np.trace(body)) < 4
    axes = fit.principal.axes
    assert abs(np.linalg.eigh(J)[1].T @ axes).max(axis=0) == pytest.approx(1, abs=2e-4)
    if how == "given":
        assert fit.delay == (LATE, pytest.approx([LATE, LATE]))
        assert "as given" in fit.table()["misalignment"]
    else:
        assert np.isnan(fit.delay[1]).all()  # free motion adds nothing to what was known of it
        assert "undetermined" in fit.table()["delay"]


def test_misalignment_of_a_pendulum():
    how = {"rotation": Rotation.from_euler("x", 80, degrees=True), "sensor": {"misalignment": THETA, "rate": 100}}
    read = recorded(heavy_top([0.018, 0.021, 0.007], MASS, CENTRE), 3, (2, -3, 6), **how)
    fit = whole(read, gravity={"mass": MASS, "centre": CENTRE}, misalignment={"error": 0.1})
    across = np.eye(3) - np.outer(CENTRE, CENTRE) / (CENTRE @ CENTRE)
    assert across @ fit.misalignment[0] == pytest.approx(across @ THETA, abs=5e-3)


def of_flight(*which, **how):
    return lambda: whole(tuple(flight()[k] for k in which or (0, 1)), **how)


test_recording_cannot_tell = refused_as(
    {
        "delay": of_flight(delay="fit"),
        "misalignment": of_flight(misalignment="fit"),
        "scales": of_flight(axis_scales="fit"),
        "an unknown word": of_flight(delay="free"),
        "no error": of_flight(delay={"value": 0.1}),
        "an unknown key": of_flight(delay={"eror": 0.1}),
        "a long delay": of_flight(delay=0.1),
        "shapes": of_flight(misalignment=1.0),
        "a negative scale": of_flight(axis_scales=[1, 1, -1]),
        "no gyroscope": of_flight(0, 2, delay=0.01),
    }
)


def test_the_command_takes_errors(tmp_path):
    time, rates, read, _ = flight(rate=100)
    path = csv(tmp_path / "throw.csv", TURNED, time, rates, read.as_quat())
    how = ["--all", "--orientation", "both", "--misalignment", "fit", "--axis-scales", "value=1,1,1,error=0.02"]
    found = json.loads(ended(0, "fit", path, *how, "--delay", LATE, "--json").stdout)
    assert (found["delay"], found["delay_interval"]) == (LATE, [LATE, LATE])
    low, high = np.transpose(found["misalignment_interval"])
    assert ((low < THETA) & (high > THETA)).all()
    assert "do not determine their delay" in ended(3, "fit", path, "--all", "--delay", "fit").output


@pytest.mark.parametrize("noise", [0.0, 1e-8])
def test_common_scale_has_no_interval(noise):
    run = simulate(standard([1, 2, 2.6]), t_end=2, material_angular_velocity=(1, 4, 0.5))
    rates = run.material_angular_velocity + noise * np.random.default_rng(1).normal(size=(len(run.time), 3))
    known = {"value": [1.01, 1, 1], "error": 0.01}
    with pytest.warns(UserWarning, match="does not determine"):
        fit = whole(run.assign(material_angular_velocity=rates), axis_scales=known)
    assert np.isnan(fit.axis_scales[1]).all()
