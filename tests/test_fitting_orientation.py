"""Inertias by recorded attitudes, alone and with a gyroscope."""

import io
import json
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fit_errors import csv, off
from nontwist import fit_inertia, heavy_top, read_motion, rotation, sensors, simulate, standard
from nontwist.cli import app
from nontwist.fitting.bodies import Model
from nontwist.fitting.measuring import continuous, derived_rates
from nontwist.fitting.motions import Motion, response
from nontwist.fitting.readings import noise_of_attitudes, scatter_of_attitudes
from nontwist.fitting.telling import quantile
from nontwist.runfile import read_run_file
from refusals import refused_as

TILT = np.radians(0.3)
J = np.array([[0.30, 0.02, -0.01], [0.02, 0.25, 0.03], [-0.01, 0.03, 0.45]])
W = np.array([8.0, 9.0, -7.0])
MASS, CENTRE = 0.5, np.array([0.03, -0.02, -0.15])


@cache
def flight(seed=0, rate=200, tilt=TILT, inertia=None):
    """Times, angular velocities and attitudes as recorded, and J of trace 1."""
    rng = np.random.default_rng(seed)
    turned = Rotation.random(rng=rng).as_matrix()
    body = turned @ np.diag([1, 1.7, 2.3]) @ turned.T / 5
    start = rng.normal(size=3)
    start *= rng.uniform(8, 16) / np.linalg.norm(start)
    begin = {"rotation": Rotation.random(rng=rng), "material_angular_velocity": start}
    run = simulate(standard(body), t_end=0.6, step=1 / rate, **begin)
    how = {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal(), "seed": seed}
    read = rotation(run) * Rotation.from_rotvec(tilt * rng.normal(size=(len(run.time), 3)))
    return run.time.values, sensors.gyroscope(run, noise=1.2e-4, **how).gyroscope.values, read, body


def by_scipy(inertia, start, attitude, times):
    """Attitudes of a free body as matrices, by SciPy."""
    inverse = np.linalg.inv(inertia)

    def slope(t, x):
        w, R = x[:3], x[3:].reshape(3, 3)
        hat = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([inverse @ np.cross(inertia @ w, w), (R @ hat).ravel()])

    x = np.concatenate([start, attitude.as_matrix().ravel()])
    return solve_ivp(slope, (0, times[-1]), x, "DOP853", times, rtol=1e-12, atol=1e-13).y[3:].T.reshape(-1, 3, 3)


HEADER = "time (s),gx (rad/s),gy (rad/s),gz (rad/s),qx,qy,qz,qw"


def table(path, time, rates, read):
    return csv(path, HEADER, time, rates, read.as_quat())


# The model


def test_the_series_turns_the_body_as_scipy_does():
    begin, times = Rotation.from_rotvec([0.4, -1.0, 2.0]), np.linspace(0.01, 0.6, 25)
    motion = Motion(Model(oriented=True), J, np.zeros(0))
    found, _ = response(motion, np.concatenate([W, begin.as_quat()]), times)
    true = by_scipy(J, W, begin, times)
    assert abs(Rotation.from_quat(found[:, 3:]).as_matrix() - true).max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:], axis=1), 1, atol=1e-10)


def test_quaternions_of_either_sign_are_made_continuous():
    _, _, read, _ = flight()
    q = read.as_quat() * np.random.default_rng(0).choice([-1, 1], size=(len(read), 1))
    q[7] = np.nan
    found = continuous(q)
    good = found[np.isfinite(found).all(axis=1)]
    assert ((good[1:] * good[:-1]).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(abs(found), abs(q))


def test_angular_velocities_follow_from_attitudes():
    run = simulate(standard(J), t_end=0.6, step=1 / 400, material_angular_velocity=W)
    found = derived_rates(run.time.values, continuous(rotation(run).as_quat()))
    assert abs(found - run.material_angular_velocity.values).max() < 0.03 * np.linalg.norm(W)  # to start from


def test_noise_and_scatter_are_those_of_the_recording():
    time, rates, read, _ = flight(2, rate=400)
    q = continuous(read.as_quat())
    assert noise_of_attitudes(q) == pytest.approx(TILT, rel=0.3)  # to start from
    assert scatter_of_attitudes(time, q, rates) == pytest.approx(TILT, rel=0.1)


# Estimates


def test_errors_are_as_large_as_the_intervals_say():
    deviations = []
    for seed in range(8):
        time, rates, read, body = flight(seed, rate=(100, 200)[seed // 2 % 2])
        recording = (time, read) if seed % 2 else (time, rates, read)
        fit = fit_inertia(recording, interval="all")
        assert fit.is_white
        assert fit.misfit == pytest.approx(1, abs=0.25)
        assert fit.attitude_noise == pytest.approx(TILT, rel=0.2)
        deviations.append(off(fit, body))
    assert abs(np.array(deviations)).max() < 4
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.5


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the recording does not determine")
@pytest.mark.parametrize("both", [False, True])
def test_intervals_of_95_percent_cover_the_truth_in_95_percent(both):
    covered = []
    for seed in range(100, 220):
        time, rates, read, body = flight(seed, rate=100)
        fit = fit_inertia((time, rates, read) if both else (time, read), interval="all")
        if not fit.untold:
            covered.append(abs(off(fit, body)) < quantile(fit.solution))
    assert len(covered) > 110
    assert 0.91 < np.mean(covered) < 0.99  # three standard errors of a share of 120


def test_attitudes_tell_more_together_with_a_gyroscope():
    time, rates, read, _ = flight(4, tilt=1e-4)
    widths = {}
    for name, recording in (("gyroscope", (time, rates)), ("attitudes", (time, read)), ("both", (time, rates, read))):
        fit = fit_inertia(recording, interval="all")
        widths[name] = fit.identifiable[-1].standard_error
        assert fit.has_gyroscope == (name != "attitudes")
    assert widths["both"] < min(widths["gyroscope"], widths["attitudes"])


def test_the_scale_of_the_gyroscope_is_in_the_attitudes():
    time, rates, read, _ = flight(5)
    fit = fit_inertia((time, 1.3 * rates, read), interval="all", scale=0.3)
    alone = fit_inertia((time, rates, read), interval="all")
    assert fit.scale == pytest.approx(1.3 * alone.scale, rel=2e-3)
    np.testing.assert_allclose(fit.principal.moments, alone.principal.moments, atol=1e-3)


def test_missing_attitudes_count_for_nothing():
    time, rates, read, body = flight(6)
    q = read.as_quat()
    q[::3] = np.nan
    recording = io.StringIO()
    csv(recording, HEADER, time, rates, q)
    recording.seek(0)
    fit = fit_inertia(recording, interval="all", orientation="both")
    assert fit.solution.turned_by.shape == (np.isfinite(q[:, 0]).sum(), 3)
    assert len(fit.residual) == len(time)
    assert abs(off(fit, body)).max() < 4


def test_a_pivoted_body_by_its_attitudes():
    true = np.array([[0.020, 0.001, -0.0005], [0.001, 0.022, 0.0008], [-0.0005, 0.0008, 0.004]])
    begin = {"rotation": Rotation.from_euler("x", 80, degrees=True), "material_angular_velocity": (2, -3, 6)}
    run = simulate(heavy_top(true, MASS, CENTRE), t_end=1, step=1 / 100, **begin)
    rng = np.random.default_rng(0)
    read = rotation(run) * Rotation.from_rotvec(np.radians(0.2) * rng.normal(size=(len(run.time), 3)))
    fit = fit_inertia((run.time.values, read), gravity={"mass": MASS, "centre": CENTRE})
    assert abs(off(fit, true)).max() < 4
    assert fit.unit == "kg m²"
    again = simulate(fit.problem(), times=fit.parts[0].time)
    assert abs(again.material_angular_velocity.values - fit.parts[0].model).max() < 1e-6


def test_the_run_file_reproduces_the_attitudes():
    time, _, read, _ = flight(2)
    fit = fit_inertia((time, read), interval="all")
    run = simulate(fit.problem(), times=time)
    gap = (rotation(run).inv() * read).as_rotvec()
    np.testing.assert_allclose(gap, fit.residual, atol=1e-7)


def test_several_flights_by_attitudes():
    rng, recordings = np.random.default_rng(8), []
    for _ in range(2):
        run = simulate(standard(J), t_end=0.6, step=1 / 100, material_angular_velocity=7 * rng.normal(size=3))
        noise = Rotation.from_rotvec(TILT * rng.normal(size=(len(run.time), 3)))
        recordings.append((run.time.values, rotation(run) * noise))
    fit = fit_inertia(recordings, interval="all")
    assert abs(off(fit, J / np.trace(J))).max() < 4
    assert abs(fit.cross_validation - 1).max() < 0.2


# Files and words


def test_the_command_reads_attitudes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, rates, read, _ = flight()
    table("throw.csv", time, rates, read)
    for orientation, rows in (("only", 0), ("both", 1)):
        how = ["fit", "throw.csv", "--all", "--orientation", orientation, "--out", f"{orientation}.toml"]
        result = CliRunner().invoke(app, [*how, "--json", "--figure", f"{orientation}.png"])
        assert result.exit_code == 0, result.output
        numbers = json.loads(result.stdout)
        given = (time, rates, read) if rows else (time, read)
        fit = fit_inertia(given, interval="all")
        np.testing.assert_allclose(numbers["moments"], fit.principal.moments, atol=1e-6)
        assert (numbers["noise"] is None) == (rows == 0)
        assert numbers["attitude_noise"] == pytest.approx(fit.attitude_noise, rel=1e-4)
        assert "orientation: quaternion qw, qx, qy, qz" in numbers["recordings"][0]["read"]
        assert "rotation" in read_run_file(f"{orientation}.toml").start.model_fields_set
    result = CliRunner().invoke(app, ["fit", "throw.csv", "--orientation", "only"])
    assert result.exit_code == 3
    csv("angles.csv", "time (s),roll,pitch,yaw", time, read.as_euler("ZYX", degrees=True)[:, ::-1])
    how = ["fit", "angles.csv", "--all", "--json", "--orientation", "euler=ZYX,angle_unit=deg"]
    result = CliRunner().invoke(app, how)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["moments"] == pytest.approx(
        fit_inertia((time, read), interval="all").principal.moments.tolist(), abs=1e-6
    )


def test_forms_of_attitudes_agree(tmp_path):
    time, rates, read, _ = flight(1)
    path = table(tmp_path / "throw.csv", time, rates, read)
    given = fit_inertia((time, read), interval="all")
    for recording, how in ((read_motion(path), {}), (path, {"orientation": "only"})):
        found = fit_inertia(recording, interval="all", **how)
        np.testing.assert_allclose(found.inertia, given.inertia, atol=1e-6)
    inverse = table(tmp_path / "inverse.csv", time, rates, read.inv())
    turned = fit_inertia(inverse, interval="all", orientation={"use": "both", "inverse": True})
    np.testing.assert_allclose(turned.inertia, fit_inertia((time, rates, read), interval="all").inertia, atol=1e-6)


def of_flight(which, **how):
    """Fit "t"imes, angular "v"elocities and "a"ttitudes, "i" where these are inverted, "s" where one is missing."""
    time, rates, read, _ = flight()
    parts = {"t": time, "v": rates, "a": read, "i": read.inv(), "s": read[:-1]}
    return lambda: fit_inertia(tuple(parts[one] for one in which), **how)


def wandering():
    steps = 0.1 * np.random.default_rng(0).normal(size=(200, 3))
    return np.arange(200) / 100, Rotation.from_rotvec(np.cumsum(steps, axis=0))


test_what_attitudes_cannot_tell_is_refused = refused_as(
    {
        "no interval": of_flight("ta"),
        "an unknown word": of_flight("tv", orientation="too"),
        "a number": of_flight("tv", orientation=3),
        "an unknown key": of_flight("tv", orientation={"eular": "ZYX"}),
        "shapes": of_flight("tvs", interval="all"),
        "mixed": lambda: fit_inertia([flight()[:2], flight()[::2]], interval="all"),
        "none": lambda: fit_inertia(sensors.gyroscope(simulate(standard(J), t_end=1)), orientation="both"),
        "no motion": lambda: fit_inertia(wandering(), interval="all"),
        "inverted": of_flight("tvi", interval="all"),
    }
)
