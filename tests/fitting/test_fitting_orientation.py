"""Inertias by recorded attitudes, alone and with a gyroscope."""

import io
import json
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import STANDARD, ended
from fit_errors import (
    CENTRE,
    MASS,
    PIVOTED,
    TURNED,
    apart,
    assert_as_wide,
    begun,
    csv,
    farthest,
    off,
    off_by,
    share_covered,
    tilted,
    whole,
)
from nontwist import fit_inertia, heavy_top, read_motion, rotation, sensors, simulate, standard
from nontwist.fitting.measuring import continuous
from nontwist.fitting.shooting import noise_of_attitudes
from nontwist.runfile import read_run_file
from refusals import refused_as, warned

TILT = np.radians(0.3)


@cache
def flight(seed=0, rate=200, tilt=TILT):
    """Times, angular velocities and attitudes as recorded, and J of trace 1."""
    rng = np.random.default_rng(seed)
    turned = Rotation.random(rng=rng).as_matrix()
    body = turned @ np.diag([1, 1.7, 2.3]) @ turned.T / 5
    run = simulate(standard(body), t_end=0.6, step=1 / rate, **begun(rng))
    read = sensors.gyroscope(run, noise=1.2e-4, **off_by(rng), seed=seed)
    return run.time.values, read.gyroscope.values, tilted(rotation(run), tilt, rng), body


def test_errors_match_intervals():
    deviations = []
    for seed in range(4):
        time, rates, read, body = flight(seed, rate=(100, 200)[seed // 2])
        recording = (time, read) if seed % 2 else (time, rates, read)
        fit = whole(recording)
        assert fit.is_white
        assert fit.misfit == pytest.approx(1, abs=0.25)
        assert fit.attitude_noise == pytest.approx(TILT, rel=0.2)
        deviations.append(off(fit, body))
    assert_as_wide(deviations)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the recording does not determine")
@pytest.mark.parametrize("both", [False, True])
def test_coverage_of_intervals(both):
    flights = (flight(seed, rate=100) for seed in range(100, 220))
    fits = ((whole((t, w, q) if both else (t, q)), body) for t, w, q, body in flights)
    assert 0.91 < share_covered(fits) < 0.99  # three standard errors of a share of 120


def test_attitudes_with_a_gyroscope():
    time, rates, read, _ = flight(4, tilt=1e-4)
    widths = {}
    for name, recording in (("gyroscope", (time, rates)), ("attitudes", (time, read)), ("both", (time, rates, read))):
        fit = whole(recording)
        widths[name] = fit.identifiable[-1].standard_error
        assert fit.has_gyroscope == (name != "attitudes")
        if name == "attitudes":
            again = simulate(fit.problem(), times=time)
            np.testing.assert_allclose((rotation(again).inv() * read).as_rotvec(), fit.residual, atol=1e-7)
    assert widths["both"] < min(widths["gyroscope"], widths["attitudes"])


def test_gyroscope_scale_from_attitudes():
    time, rates, read, _ = flight(4, tilt=1e-4)
    fits = [whole((time, c * rates, read), scale=0.3) for c in (1, 1.3)]
    assert fits[1].scale == pytest.approx(1.3 * fits[0].scale, rel=2e-3)
    np.testing.assert_allclose(fits[1].principal.moments, fits[0].principal.moments, atol=1e-3)


def test_missing_attitudes():
    time, rates, read, body = flight(6)
    q, order, recording = read.as_quat(), np.append(np.arange(len(time) - 1) ^ 1, len(time) - 1), io.StringIO()
    q[::3] = np.nan
    csv(recording, TURNED, time[order], rates[order], np.where(np.arange(len(q))[:, None] % 6, q, 0.0)[order])
    recording.seek(0)
    with warned("unsorted-times"):
        fit = whole(recording, orientation="both")
    assert fit.solution.turned_by.shape == (np.isfinite(q[:, 0]).sum(), 3)
    assert len(fit.residual) == len(time)
    assert farthest(fit, body) < 4
    order = np.random.default_rng(0).permutation(len(time))
    with warned("unsorted-times"):
        shuffled = whole((time[order], rates[order], read[order]))
    np.testing.assert_allclose(shuffled.inertia, whole((time, rates, read)).inertia, atol=1e-6)


def test_noise_of_attitudes():
    _, _, read, _ = flight(2, rate=400)
    assert noise_of_attitudes(continuous(read.as_quat())) == pytest.approx(TILT, rel=0.3)  # to start from


def test_pivoted_body():
    begin = {"rotation": Rotation.from_euler("x", 80, degrees=True), "material_angular_velocity": (2, -3, 6)}
    run = simulate(heavy_top(PIVOTED, MASS, CENTRE), t_end=1, step=1 / 100, **begin)
    read = tilted(rotation(run), np.radians(0.2), np.random.default_rng(0))
    fit = fit_inertia((run.time.values, read), gravity={"mass": MASS, "centre": CENTRE})
    assert farthest(fit, PIVOTED) < 4
    assert fit.unit == "kg m²"
    assert apart(fit) < 1e-6


# Files and words


@pytest.mark.usefixtures("here")
def test_forms_of_attitudes():
    time, rates, read, _ = flight(rate=100)
    fits = {"only": whole((time, read)), "both": whole((time, rates, read))}
    path = csv("throw.csv", TURNED, time, rates, read.as_quat())
    inverse = csv("inverse.csv", TURNED, time, rates, read.inv().as_quat())
    found = whole(read_motion(path)), whole(inverse, orientation={"use": "both", "inverse": True})
    for one, fit in zip(found, fits.values(), strict=True):
        np.testing.assert_allclose(one.inertia, fit.inertia, atol=1e-6)
    csv("angles.csv", "time (s),roll,pitch,yaw", time, read.as_euler("ZYX", degrees=True)[:, ::-1])
    for name, file, orientation, said in (
        ("both", "throw.csv", "both", "orientation: quaternion qw, qx, qy, qz"),
        ("only", "angles.csv", "euler=ZYX,angle_unit=deg", ""),
    ):
        how = ["--all", "--orientation", orientation, "--json", "--force", "--out", f"{name}.toml"]
        numbers = json.loads(ended(0, "fit", file, *how).stdout)
        np.testing.assert_allclose(numbers["moments"], fits[name].principal.moments, atol=1e-6)
        assert (numbers["noise"] is None) == (name == "only")
        assert numbers["attitude_noise"] == pytest.approx(fits[name].attitude_noise, rel=1e-4)
        assert said in str(numbers["recordings"][0]["read"])
        assert "rotation" in read_run_file(f"{name}.toml").start.model_fields_set
    ended(0, "fit", "throw.csv", "--all", "--orientation", "only", "--figure", "only.png")
    ended(3, "fit", "throw.csv", "--orientation", "only")


def of_flight(which, **how):
    """Fit "t"imes, angular "v"elocities and "a"ttitudes, "i" where these are inverted, "s" where one is missing."""
    time, rates, read, _ = flight()
    parts = {"t": time, "v": rates, "a": read, "i": read.inv(), "s": read[:-1]}
    return lambda: fit_inertia(tuple(parts[one] for one in which), **how)


def wandering():
    steps = 0.1 * np.random.default_rng(0).normal(size=(200, 3))
    return np.arange(200) / 100, Rotation.from_rotvec(np.cumsum(steps, axis=0))


test_attitudes_cannot_tell = refused_as(
    {
        "no interval": of_flight("ta"),
        "an unknown word": of_flight("tv", orientation="too"),
        "a number": of_flight("tv", orientation=3),
        "an unknown key": of_flight("tv", orientation={"eular": "ZYX"}),
        "shapes": of_flight("tvs", interval="all"),
        "mixed": lambda: whole([flight()[:2], flight()[::2]]),
        "none": lambda: fit_inertia(sensors.gyroscope(simulate(STANDARD, t_end=1)), orientation="both"),
        "no motion": lambda: whole(wandering()),
        "inverted": of_flight("tvi", interval="all"),
    }
)
