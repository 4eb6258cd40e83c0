"""Inertias by recordings: the model against SciPy, estimates against known bodies, what is said of bad recordings."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fit_errors import csv, model_of, off
from nontwist import (
    Problem,
    body_moment,
    fit_inertia,
    inertia,
    nontwisting,
    plot,
    save_run,
    sensors,
    simulate,
    standard,
)
from nontwist.cli import app
from nontwist.fitting.bodies import FREE_BODY, TRACELESS, Model, entries
from nontwist.fitting.estimating import estimate, pencil, turns, with_moments
from nontwist.fitting.measuring import plain_gyroscope, triangle
from nontwist.fitting.motions import Motion, RunawayError, response
from nontwist.fitting.readings import correlation, noise_of, scatter_of
from nontwist.fitting.reports import _number as number_in_words
from nontwist.fitting.shooting import Shooting, Stretch, stacked
from nontwist.fitting.telling import beyond_the_wall, quantile, to_the_wall
from nontwist.geometry.tensors import ENTRIES
from nontwist.recordings.headers import ACCELEROMETER, GYROSCOPE, rate_unit
from nontwist.recordings.headers import sensors as three_axes
from nontwist.recordings.reading import Rates
from nontwist.runfile import read_run_file
from refusals import refused, refused_as

J = np.array([[0.30, 0.02, -0.01], [0.02, 0.25, 0.03], [-0.01, 0.03, 0.45]])
PHONE = inertia.of_cuboid(0.18, (0.147, 0.072, 0.008))
W = np.array([8.0, 9.0, -7.0])
TIMES = np.sort(np.random.default_rng(4).uniform(0, 0.6, 40))  # uneven, as recordings are


def rates_by_scipy(inertia, start, times):
    """Angular velocities, of real or complex numbers, by SciPy."""
    inverse = np.linalg.inv(inertia)

    def slope(t, w):
        return inverse @ np.cross(inertia @ w, w)

    start = np.asarray(start, dtype=np.result_type(inertia, np.asarray(start)))
    return solve_ivp(slope, (0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-14).y.T


@cache
def throw(seed=0, rate=400, density=1.2e-4, phone=True, seconds=0.6):
    """A recording of a free body: J of trace 1, and what the gyroscope reads."""
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    inertia = turned @ (PHONE if phone else np.diag([1, 1.7, 2.3])) @ turned.T
    start = rng.normal(size=3)
    start *= rng.uniform(8, 16) / np.linalg.norm(start)
    run = simulate(standard(inertia), t_end=seconds, step=1 / 400, material_angular_velocity=start)
    how = {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal(), "rate": rate, "seed": seed}
    return inertia / np.trace(inertia), sensors.gyroscope(run, noise=density, **how)


@cache
def hand(seed=1):
    """Times and angular velocities of a phone that is thrown at 0.75 s, caught at 1.35 s, and its J."""
    rng = np.random.default_rng(seed)
    t, moments = np.array([0, 0.5, 0.6, 0.7, 0.75]), np.zeros((5, 3))
    moments[2:4] = rng.normal(size=(2, 3)) * [[90], [60]] @ PHONE
    how = {"load": body_moment(t, moments), "material_angular_velocity": (0.3, 0.2, -0.1)}
    run = simulate(standard(PHONE), t_end=1.35, step=1 / 2000, **how)
    flight = sensors.gyroscope(run, noise=1.2e-4, bias=(0.01, 0.02, -0.01), scale=1.005, rate=400, seed=seed)
    after = np.arange(1, 81) / 400
    caught = flight.gyroscope.values[-1] * np.exp(-after / 0.05)[:, None] + 0.002 * rng.normal(size=(80, 3))
    time = np.concatenate([flight.time.values, 1.35 + after])
    return time, np.concatenate([flight.gyroscope.values, caught]), PHONE / np.trace(PHONE)


HEADER = "time (s),gyr_x (deg/s),gyr_y (deg/s),gyr_z (deg/s)"


def in_degrees(path, time, rates, header=HEADER, *more):
    return csv(path, header, time, np.degrees(rates), *more)


# The model


def test_the_series_is_the_motion_that_scipy_finds_and_its_derivatives_those_of_complex_steps():
    found, D = response(Motion(FREE_BODY, J, np.zeros(0)), W, TIMES)
    assert abs(found - rates_by_scipy(J, W, TIMES)).max() < 1e-10 * np.linalg.norm(W)
    h = 1e-30
    for k in range(9):
        change, start = np.zeros((3, 3)), W + 1j * h * np.eye(9, 3)[k]
        if k >= 3:
            i, j = ENTRIES[k - 3]
            change[i, j] = change[j, i] = 1
        true = rates_by_scipy(J + 1j * h * change, start, TIMES).imag / h
        assert abs(D[:, :, k] - true).max() < 1e-9 * abs(true).max()


def test_the_series_keeps_energy_and_momentum_over_many_turns():
    found, _ = response(Motion(FREE_BODY, J, np.zeros(0)), W, np.linspace(0, 60, 50))
    for value in (np.einsum("ni,ij,nj->n", found, J, found), np.linalg.norm(found @ J, axis=1)):
        assert abs(value / value[0] - 1).max() < 1e-9


@pytest.mark.parametrize("centre", [J, PHONE / np.trace(PHONE), np.diag([0.25, 0.25, 0.5])])
@pytest.mark.parametrize("physical", [True, False])
def test_all_numbers_give_a_body(centre, physical):
    model, none = Model(physical=physical), np.zeros(0)
    start = model.nearest(centre, none)
    np.testing.assert_allclose(model.inertia(model.cholesky(centre, none), none)[0], start, atol=1e-14)
    assert np.trace(start) == pytest.approx(1, abs=1e-14)
    for v in np.random.default_rng(1).normal(size=(20, 6)):
        found, slope = model.inertia(v, none)
        assert np.linalg.eigvalsh(np.trace(found) / 2 * np.eye(3) - found if physical else found)[0] > -1e-14
        for k, e in enumerate(1e-6 * np.eye(6)):
            change = (entries(model.inertia(v + e, none)[0]) - entries(model.inertia(v - e, none)[0])) / 2e-6
            np.testing.assert_allclose(slope[:, k], change, atol=1e-8)


def test_the_linear_methods_find_the_inertia_of_clean_recordings():
    times = np.arange(400) / 400
    rates = rates_by_scipy(J, W, times)
    found = with_moments([(times, rates)], FREE_BODY, 2.0, 0.0)
    assert abs(found.inertia - J).max() < 1e-4
    assert found.misfit < 1e-4
    assert abs(pencil([(times, rates)]) - J).max() < 0.01  # half a degree of its search


def test_energy_and_momentum_need_no_time():
    times = np.arange(30) / 5  # 2.8 rad from sample to sample
    assert abs(pencil([(times, rates_by_scipy(J, W, times))]) - J).max() < 0.01


@pytest.mark.parametrize("shape", [(5000, 30), (700, 95), (20, 30)])
def test_a_triangle_has_the_products_of_the_columns(shape):
    A = np.random.default_rng(0).normal(size=shape) * np.geomspace(1, 1e6, shape[1])
    R = triangle(A)
    assert len(R) == min(shape)
    assert shape[0] < shape[1] or (np.tril(R, -1) == 0).all()
    size = np.linalg.norm(A, axis=0)
    assert abs((R.T @ R - A.T @ A) / np.outer(size, size)).max() < 1e-12


@pytest.mark.parametrize("n", [2, 3, 100, 101])
def test_turns_are_the_products_of_the_steps(n):
    rng = np.random.default_rng(n)
    t, w = np.cumsum(rng.uniform(0.01, 0.02, n)), rng.normal(size=(n, 3)) * 5
    now, found = Rotation.identity(), turns(t, w)
    for k in range(n):
        assert abs(found[k] - now.as_matrix()).max() < 1e-14 * n
        now = now if k == n - 1 else now * Rotation.from_rotvec((w[k] + w[k + 1]) / 2 * (t[k + 1] - t[k]))


def test_a_motion_that_runs_away_is_given_up():
    faster = Motion(Model(damping=1), J, np.array([-30.0]))
    with pytest.raises(RunawayError, match="not finite, or needs too many steps"):
        response(faster, W, np.linspace(0, 2, 300))


def test_the_covariance_is_the_inverse_of_all_information():
    _, recording = throw(3)
    stretch = Stretch(recording.time.values, recording.gyroscope.values)
    found = estimate(Shooting([stretch], plain_gyroscope(0.02, 0.01), 2e-3))
    _, slope = stacked([*found.residuals.rates, *found.residuals.beside], found.problem.columns)
    A = np.concatenate([slope[:, :6] @ TRACELESS, slope[:, 6:]], axis=1)
    scale = np.linalg.norm(A, axis=0)
    full = np.linalg.inv((A / scale).T @ (A / scale)) / np.outer(scale, scale)
    np.testing.assert_allclose(np.linalg.inv(found.information), full[:5, :5], rtol=1e-4)


# Estimates


def test_errors_are_as_large_as_the_intervals_say():
    deviations = []
    for seed in range(8):
        inertia, recording = throw(seed, rate=(100, 400)[seed % 2], phone=seed % 3 == 0)
        deviations.append(off(fit_inertia(recording, interval="all"), inertia))
    assert abs(np.array(deviations)).max() < 4
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.5


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the recording does not determine")
def test_intervals_of_95_percent_cover_the_truth_in_95_percent():
    covered = []
    for seed in range(100, 220):
        inertia, recording = throw(seed, rate=100, phone=seed % 2 == 0)
        fit = fit_inertia(recording, interval="all")
        if not fit.untold:
            covered.append(abs(off(fit, inertia)) < quantile(fit.solution))
    assert len(covered) > 110
    assert 0.91 < np.mean(covered) < 0.99  # three standard errors of a share of 120


def test_recordings_together_tell_more_than_the_best_alone():
    # three throws of one body
    rng = np.random.default_rng(8)
    recordings = []
    for seed in range(3):
        run = simulate(standard(PHONE), t_end=0.6, step=1 / 400, material_angular_velocity=7 * rng.normal(size=3))
        recordings.append(sensors.gyroscope(run, noise=5e-4, bias=(0.01, 0, 0), rate=100, seed=seed))
    together = fit_inertia(recordings, interval="all")
    alone = [fit_inertia(one, interval="all") for one in recordings]
    assert abs(off(together, PHONE / np.trace(PHONE))).max() < 4
    assert together.identifiable[-1].standard_error < min(one.identifiable[-1].standard_error for one in alone)
    assert abs(together.cross_validation - 1).max() < 0.15
    assert alone[0].cross_validation.size == 0


def test_another_body_among_the_recordings_shows():
    recordings = []
    for seed, thickness in enumerate((0.008, 0.008, 0.012)):
        body = standard(inertia.of_cuboid(0.18, (0.147, 0.072, thickness)))
        start = 7 * np.random.default_rng(seed).normal(size=3)
        run = simulate(body, t_end=0.6, step=1 / 400, material_angular_velocity=start)
        recordings.append(sensors.gyroscope(run, noise=1.2e-4, rate=100, seed=seed))
    assert fit_inertia(recordings[:2], interval="all").cross_validation.max() < 1.2
    with pytest.warns(UserWarning, match=r"^the residuals are \S+ times what noise explains: "):
        fit = fit_inertia(recordings, interval="all")
    assert fit.cross_validation[2] > 2 > fit.cross_validation[:2].max()


def test_the_run_file_reproduces_the_motion(tmp_path):
    _, recording = throw(2)
    fit = fit_inertia(recording)
    assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6
    fit.problem().write(tmp_path / "run.toml")
    run = simulate(read_run_file(tmp_path / "run.toml").problem, times=fit.parts[0].time)
    assert abs(fit.scale * run.material_angular_velocity.values + fit.bias - fit.parts[0].model).max() < 1e-6


def test_uneven_times_gaps_and_bad_rows(recwarn):
    inertia, recording = throw(5)
    t, y = recording.time.values.copy(), recording.gyroscope.values.copy()
    y[7, 1] = np.nan
    kept = np.ones(len(t), dtype=bool)
    kept[100:140] = False
    order = np.random.default_rng(0).permutation(np.flatnonzero(kept))
    fit = fit_inertia((t[order], y[order]), interval="all")
    assert abs(off(fit, inertia)).max() < 4
    assert fit.parts[0].left_out == 1
    said = [one.message for one in recwarn]
    assert [one.code for one in said] == ["missing-rates", "unsorted-times", "gaps"]
    assert {one.within for one in said} == {"the recording"}
    first, last = (f"row {np.flatnonzero(order == k)[0]}" for k in (99, 140))
    assert {key: said[2].fields[key] for key in ("gaps", "first", "last")} == {
        "gaps": "1 gap",
        "first": first,
        "last": last,
    }
    assert said[2].fields["step"] == pytest.approx(0.1025)


def test_attitudes_stay_with_their_rows():
    t, rates, number = np.arange(60) / 10, np.ones((60, 3)), np.arange(60.0)
    rates[[7, 11]] = np.nan
    order = np.random.default_rng(0).permutation(60)
    found = Rates(t[order], rates[order], "", (), None, number[order], np.tile(number[order, None], 4)).cleaned()
    assert np.array_equal(found.quaternions[:, 0], found.speed)
    assert np.array_equal(found.speed, np.delete(number, [7, 11]))


def test_a_robust_loss_bears_wrong_samples():
    inertia, recording = throw(6)
    t, y = recording.time.values, recording.gyroscope.values.copy()
    y[::29] += 0.3
    robust = fit_inertia((t, y), interval="all", loss="soft_l1", noise=2e-3)
    assert abs(off(robust, inertia)).max() < 5
    with pytest.warns(UserWarning, match=re.escape("times the noise off: an impact? --loss soft_l1 (loss=) counts")):
        plain = fit_inertia((t, y), interval="all")
    assert (
        abs(plain.principal.moments - np.linalg.eigvalsh(inertia)).max()
        > 3 * abs(robust.principal.moments - np.linalg.eigvalsh(inertia)).max()
    )


def test_at_the_wall_an_interval_ends_where_bodies_are_flat():
    run = simulate(standard(PHONE), t_end=0.6, step=1 / 400, material_angular_velocity=(2, 9, 3))
    fit = fit_inertia(sensors.gyroscope(run, noise=4e-3, rate=100, seed=3), interval="all")
    low, high = fit.principal.intervals[2]
    assert high == 0.5
    assert low < np.linalg.eigvalsh(PHONE)[2] / np.trace(PHONE) < high
    assert fit.table()["J3 / sum"].endswith(" to 0.50000)")


def test_far_from_the_wall_the_profile_is_the_normal_interval():
    _, recording = throw(1, phone=False)
    fit = fit_inertia(recording, interval="all")
    np.testing.assert_allclose(
        to_the_wall(fit.solution, quantile(fit.solution), fit.covariance), fit.principal.intervals[2], atol=2e-5
    )


# What cannot be told


def test_steady_spin_tells_the_axis_and_no_moment(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a long path would leave the table no room
    run = simulate(standard([1, 2, 2.5]), t_end=0.6, step=1 / 400, material_angular_velocity=(0, 0, 12))
    recording = sensors.gyroscope(run, noise=1e-4, rate=400)
    with pytest.warns(
        UserWarning, match="^the recording does not determine .*: turn the body about a second axis, or longer$"
    ):
        fit = fit_inertia(recording)
    assert len(fit.untold) == 3
    assert np.isnan(fit.principal.moments).all()
    assert np.isnan(fit.principal.intervals).all()
    assert np.isfinite(fit.inertia[[0, 1], 2]).all()
    assert abs(fit.inertia[[0, 1], 2]).max() < 1e-3
    assert np.isnan(fit.inertia[[0, 1, 2, 0], [0, 1, 2, 1]]).all()
    assert "turn it about a second axis" in fit.table()["undetermined"]
    assert beyond_the_wall(fit.solution, fit.told) == 0
    with pytest.raises(ValueError, match="does not determine the whole inertia"):
        fit.problem()
    assert len(fit.plot().figure.axes) == 3
    in_degrees("spin.csv", recording.time.values, recording.gyroscope.values)
    result = CliRunner().invoke(app, ["fit", "spin.csv", "--out", "body.toml"])
    assert result.exit_code == 3
    assert "undetermined" in result.stdout
    assert "not written: " in result.stderr
    assert not (tmp_path / "body.toml").exists()


def test_directions_are_named_by_principal_axes():
    _, recording = throw(2)
    fit = fit_inertia(recording, interval="all")
    gram = np.array([[np.sum(a.matrix * b.matrix) for a in fit.identifiable] for b in fit.identifiable])
    np.testing.assert_allclose(gram, np.eye(5), atol=1e-12)
    errors = [one.standard_error for one in fit.identifiable]
    assert errors == sorted(errors)
    for one in fit.identifiable:
        along = TRACELESS.T @ (entries(one.matrix) * [1, 1, 1, 2, 2, 2])
        assert np.sqrt(1 / (along @ fit.solution.information @ along)) == pytest.approx(one.standard_error)
        assert one.name.startswith(("the principal moment ", "the difference of the ", "the directions of the "))


# The interval


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_flight_is_found_between_release_and_catch(seed):
    time, rates, inertia = hand(seed)
    fit = fit_inertia((time, rates))
    (part,) = fit.parts
    assert part.interval == "the smallest residual"
    assert 0.74 <= part.time[0] <= 0.79
    assert 1.31 <= part.time[-1] <= 1.35
    assert abs(off(fit, inertia)).max() < 4


def test_an_accelerometer_tells_the_flight(tmp_path):
    time, rates, _ = hand()
    flight = (time > 0.75) & (time < 1.35)
    acceleration = np.where(flight[:, None], [0.02, 0, 0.01], [0, 0, 9.81])
    header = "time (s),gx (deg/s),gy (deg/s),gz (deg/s),ax,ay,az"
    fit = fit_inertia(in_degrees(tmp_path / "throw.csv", time, rates, header, acceleration))
    assert fit.parts[0].interval == "the accelerometer reads almost nothing"
    assert 0.74 <= fit.parts[0].time[0] <= 0.79
    assert 1.31 <= fit.parts[0].time[-1] <= 1.36


def test_a_free_recording_is_taken_whole():
    _, recording = throw(1)
    assert len(fit_inertia(recording).parts[0].time) == 241


# What is said of bad recordings


def free_part(factor=1.0):
    time, rates, _ = hand()
    free = (time > 0.76) & (time < 1.34)
    return time[free], factor * rates[free]


def not_a_body(noise=1e-3):
    """Rates that obey Euler's equations of J3 > J1 + J2."""
    times = np.arange(240) / 400
    rates = rates_by_scipy(np.diag([0.2, 0.29, 0.51]), (4.0, 6.0, 9.0), times)
    return times, rates + noise * np.random.default_rng(0).normal(size=rates.shape)


def wandering():
    return np.arange(600) / 100, np.cumsum(np.random.default_rng(0).normal(size=(600, 3)), axis=0)


test_bad_recordings_are_refused = refused_as(
    {
        "slow": lambda: fit_inertia(free_part(1 / 60)),
        "coarse": lambda: fit_inertia(free_part(60)),
        "short": lambda: fit_inertia(tuple(one[:11] for one in free_part())),
        "saturated": lambda: fit_inertia((free_part()[0], np.clip(free_part()[1], -8, 8)), interval="all"),
        "a hand": lambda: fit_inertia(hand()[:2], interval="all"),
        "two bodies": lambda: fit_inertia([throw(4)[1], throw(4, phone=False)[1]], interval="all"),
        "not in it": lambda: fit_inertia(hand()[:2], interval=(3, 4)),
        "empty interval": lambda: fit_inertia(hand()[:2], interval=(1, 1)),
        "unknown interval": lambda: fit_inertia(hand()[:2], interval="flight"),
        "no motion": lambda: fit_inertia(wandering()),
        "no body": lambda: fit_inertia(not_a_body(), interval="all"),
        "no recording": lambda: fit_inertia([]),
        "a number": lambda: fit_inertia(3),
        "shapes": lambda: fit_inertia((TIMES, np.zeros((3, 3)))),
        "loss": lambda: fit_inertia(throw()[1], loss="huber"),
        "bias": lambda: fit_inertia(throw()[1], bias=0),
        "physical": lambda: fit_inertia(throw()[1], physical=1),
        "plot": lambda: fit_inertia(throw(1)[1], interval="all").plot(1),
    }
)


def test_any_inertia_that_the_equations_allow_is_fitted_where_it_may_be():
    fit = fit_inertia(not_a_body(), interval="all", physical=False)
    assert abs(off(fit, np.diag([0.2, 0.29, 0.51]))).max() < 4
    assert fit.is_explained
    assert abs(model_of(fit) - fit.parts[0].model).max() < 1e-6
    _, recording = throw(1, phone=False)
    found = [fit_inertia(recording, interval="all", physical=one).principal.moments for one in (True, False)]
    np.testing.assert_allclose(*found, atol=1e-6)  # where bodies are, it makes no difference


def test_the_command_fits_it_and_writes_its_motion(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    in_degrees("water.csv", *not_a_body())
    result = CliRunner().invoke(app, ["fit", "water.csv", "--all", "--unphysical", "--out", "water.toml"])
    assert result.exit_code == 0, result.output
    found = np.sort(np.linalg.eigvalsh(Problem.read("water.toml").system.inertia))
    assert found / found.sum() == pytest.approx([0.2, 0.29, 0.51], abs=1e-3)
    assert CliRunner().invoke(app, ["fit", "water.csv", "--all", "--out", "body.toml"]).exit_code == 3


# Files


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("Gyroscope X (deg/s)", "deg/s"),
        ("gyr_x [rad/s]", "rad/s"),
        ("gx (°/s)", "deg/s"),
        ("wx_dps", "deg/s"),
        ("Gyroscope x (rad/s)", "rad/s"),
        ("GyroX [rad·s⁻¹]", "rad/s"),
        ("gx_rad_s", "rad/s"),
        ("gyro x (mdps)", "mdeg/s"),
        ("gx (rad s^-1)", "rad/s"),
        ("rotationRateX (radians/second)", "rad/s"),
        ("omega_x (rpm)", "rpm"),
        ("gx", None),
        ("gx (g)", None),
    ],
)
def test_gyroscopes_are_found_by_their_headers(header, unit):
    three = tuple(
        re.sub(r"([xX])(?=[^a-zA-Z]|$|_)", lambda m, y=y: y if m[1] == "x" else y.upper(), header) for y in "xyz"
    )
    found = three_axes(["time", *three, "ax", "ay", "az"], GYROSCOPE)
    assert [one[1] for one in found] == [three]
    assert {rate_unit(one) for one in three} == {unit}
    assert [one[1] for one in three_axes([*three, "ax", "ay", "az"], ACCELEROMETER)] == [("ax", "ay", "az")]


def test_files_say_what_they_are(tmp_path):
    time, rates, _ = hand()
    fit = fit_inertia(in_degrees(tmp_path / "throw.csv", time, rates))
    assert fit.parts[0].notes == (
        "angular velocity: gyr_x (deg/s), gyr_y (deg/s), gyr_z (deg/s), deg/s",
        "time: column 'time (s)', s",
    )
    bare = in_degrees(tmp_path / "bare.csv", time, rates, "time (s),gx,gy,gz")
    assert np.array_equal(fit_inertia(bare, unit="°/s").inertia, fit.inertia)
    named = in_degrees(tmp_path / "named.csv", time, rates, "when,a,b,c")
    chosen = fit_inertia(named, columns=["when", "a", "b", "c"], unit="deg/s")
    assert np.array_equal(chosen.inertia, fit.inertia)
    timeless = in_degrees(tmp_path / "timeless.csv", 0 * time, rates, "n,gx (deg/s),gy (deg/s),gz (deg/s)")
    assert abs(fit_inertia(timeless, rate=400).inertia - fit.inertia).max() < 1e-7
    for source, code, how in (
        (bare, "no-unit", {}),
        (bare, "unit", {"unit": "furlongs"}),
        (named, "no-gyroscope", {}),
        (named, "no-column", {"columns": ["a", "b", "d"]}),
        (timeless, "no-time", {}),
    ):
        with refused(code):
            fit_inertia(source, **how)


def test_runs_are_recordings(tmp_path):
    run = simulate(standard([1, 2, 2.5]), t_end=1, step=0.005, material_angular_velocity=(3, 8, 1))
    save_run(run, tmp_path / "run.nc")
    for recording in (run, tmp_path / "run.nc"):
        fit = fit_inertia(recording, interval="all")
        assert abs(fit.principal.moments - np.array([1, 2, 2.5]) / 5.5).max() < 1e-5


def test_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time, rates, inertia = hand()
    in_degrees("throw.csv", time, rates)
    runner = CliRunner()
    result = runner.invoke(app, ["fit", "throw.csv", "--json", "--out", "body.toml", "--figure", "fit.png"])
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    np.testing.assert_allclose(numbers["moments"], np.linalg.eigvalsh(inertia), atol=2e-3)
    assert numbers["recordings"][0]["name"] == "throw.csv"
    assert len(numbers["identifiable"]) == 5
    found = read_run_file("body.toml")
    np.testing.assert_allclose(found.body.inertia, numbers["inertia"])
    assert found.title == "Motion as fitted; moments of inertia in parts of their sum"
    assert (tmp_path / "fit.png").stat().st_size > 10_000
    table = runner.invoke(app, ["fit", "throw.csv", "--from", "0.8", "--to", "1.3"])
    assert table.exit_code == 0
    assert "as given" in table.stdout
    assert "J1 / sum" in table.stdout
    in_degrees("other.csv", *hand(2)[:2])
    several = runner.invoke(app, ["fit", "throw.csv", "other.csv"])
    assert several.exit_code == 0
    assert "cross-validation" in several.stdout
    for status, given in (
        (5, "throw.csv --out body.toml"),
        (2, "throw.csv --from 0.8"),
        (2, "throw.csv --all --from 0 --to 1"),
        (2, "throw.csv -"),
        (5, "nothing.csv"),
    ):
        assert runner.invoke(app, ["fit", *given.split()]).exit_code == status, given
    wrong = runner.invoke(app, ["fit", "throw.csv", "--unit", "rad/s"])
    assert wrong.exit_code == 3
    assert "state deg/s, but --unit is rad/s; omit it, or rename the columns\n" in wrong.stderr
    plain = Path("throw.csv").read_text(encoding="utf-8").replace(" (deg/s)", "")
    Path("plain.csv").write_text(plain, encoding="utf-8")
    wrong = runner.invoke(app, ["fit", "plain.csv", "--unit", "rad/s"])
    assert wrong.exit_code == 3
    assert "or is the unit deg/s?" in wrong.stderr
    assert "Traceback" not in wrong.stderr


def test_the_figure_shows_data_residuals_and_moments(tmp_path):
    _, recording = throw(1)
    ax = fit_inertia(recording, interval="all").plot()
    titles = [ax.get_title() for ax in ax.figure.axes]
    assert titles == ["data and model", "residual and 2 σ", "principal moments"]
    plot.save(ax, tmp_path / "fit.png")


# The sensor


def test_a_perfect_gyroscope_reads_the_angular_velocity():
    run = simulate(standard(J), t_end=1, step=0.01, material_angular_velocity=W)
    found = sensors.gyroscope(run)
    assert np.array_equal(found.gyroscope.values, run.material_angular_velocity.values)
    dense = sensors.gyroscope(run, rate=250, bias=(1, 2, 3), scale=1.5)
    true = rates_by_scipy(J, W, dense.time.values)
    np.testing.assert_allclose(dense.gyroscope.values, 1.5 * true + [1, 2, 3], atol=1e-7)
    assert dense.gyroscope.attrs["units"] == "rad s-1"


def test_noise_and_correlation_of_alternating_signs():
    """In closed form: sixth differences are 64, with the norm √924 for white noise; a quintic has none."""
    n, t = 40, np.linspace(0, 1, 40)
    signs = np.tile((-1.0) ** np.arange(n), (3, 1)).T
    assert noise_of(7 * signs + np.stack([t, t**3, t**5], axis=1)) == pytest.approx(7 * 64 / 0.6745 / np.sqrt(924))
    assert noise_of(signs[:13]) == 0 < noise_of(signs[:14])
    for lag in (1, 2, 3):
        assert correlation(7 * signs + 3, lag) == pytest.approx((-1) ** lag * (n - lag) / n)


@pytest.mark.parametrize("rates", [1e-3, 50.0])  # one window, and as many as there may be
def test_scatter_is_unbiased_and_that_of_what_no_polynomial_has(rates):
    n, time = 700, np.linspace(0, 7, 700)
    samples = np.random.default_rng(0).normal(size=(n, 3))
    rates = np.full((n, 3), rates)
    found = scatter_of(time, samples, rates)
    assert found == pytest.approx(1, rel=4 / np.sqrt(2 * 3 * n * (1 - 9 / 14)))
    assert scatter_of(time + 5, 3 * samples + time[:, None] ** 7 / 7**7, rates) == pytest.approx(3 * found, rel=1e-9)


def test_the_noise_has_the_density_of_a_data_sheet():
    run = simulate(nontwisting([3, 4, 5]), t_end=100, step=0.01, material_angular_velocity=(0, 0, 0))
    found = sensors.gyroscope(run, noise=2e-3, seed=5).gyroscope.values
    assert np.std(found) == pytest.approx(2e-3 * np.sqrt(100 / 2), rel=0.02)
    assert noise_of(found) == pytest.approx(np.std(found), rel=0.05)
    assert abs(correlation(found)) < 4 / np.sqrt(found.size)
    frequency = np.fft.rfftfreq(len(found), 0.01)
    density = 2 * 0.01 / len(found) * abs(np.fft.rfft(found[:, 0])) ** 2  # one-sided
    for low, high in ((1, 10), (20, 40)):
        assert np.sqrt(density[(frequency > low) & (frequency < high)].mean()) == pytest.approx(2e-3, rel=0.1)
    assert np.array_equal(found, sensors.gyroscope(run, noise=2e-3, seed=5).gyroscope.values)
    assert not np.array_equal(found, sensors.gyroscope(run, noise=2e-3, seed=6).gyroscope.values)


def sensed(**how):
    return sensors.gyroscope(simulate(standard(J), t_end=1, step=0.1, material_angular_velocity=W), **how)


test_wrong_sensors = refused_as(
    {
        "noise": lambda: sensed(noise=-1),
        "scale": lambda: sensed(scale=0),
        "rate": lambda: sensed(rate=0.5),
        "delay": lambda: sensed(delay=-0.01),
        "delay without a rate": lambda: sensed(delay=0.01),
        "uneven": lambda: sensors.gyroscope(
            simulate(standard(J), t_end=1, times=[0, 0.1, 0.5], material_angular_velocity=W), noise=1
        ),
    }
)


def test_values_are_written_to_the_digits_that_their_intervals_have():
    assert number_in_words(0.2, (0.1, 0.3)) == "0.20 (0.10 to 0.30)"
    assert number_in_words(12.3456, (12.343, 12.347), " s") == "12.3456 (12.3430 to 12.3470) s"
    assert number_in_words(1.25e-5, (1.2e-5, 1.3e-5)) == "1.250e-05 (1.200e-05 to 1.300e-05)"
    assert number_in_words(0.0, (-1e-5, 1e-5)) == "0.0e+00 (-1.0e-05 to 1.0e-05)"
    assert number_in_words(np.nan, (0.0, 1.0)) == "undetermined"
    assert number_in_words(2.0, (1.0, np.inf)) == "2, without an interval"


def test_a_run_of_one_interval_of_the_sensor_has_two_samples():
    run = simulate(standard([1, 2, 2.5]), t_end=0.01, step=0.005, material_angular_velocity=(3, 8, 1))
    assert sensors.gyroscope(run, rate=100).time.values == pytest.approx([0, 0.01], abs=1e-15)
    with pytest.raises(ValueError, match="less than two samples"):
        sensors.gyroscope(run, rate=99)


def test_a_search_without_result_says_which_motion_it_looked_for():
    with pytest.raises(ValueError, match=r"no free motion found: nowhere .* follow J W' = J W × W"):
        fit_inertia(wandering())
