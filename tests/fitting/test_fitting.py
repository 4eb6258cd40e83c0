"""Inertias by recordings: the model against SciPy, estimates against known bodies, what is said of bad recordings."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import ended
from fit_errors import FREE, apart, assert_as_wide, csv, farthest, off, off_by, recorded, share_covered, whole
from nontwist.fitting.intervals import falls
from nontwist.fitting.predictions import Motion, RunawayError, Track, responses
from nontwist.fitting.reports import _number as number_in_words
from nontwist.fitting.shooting import correlation, noise_of, require_turning, stacked
from nontwist.fitting.telling import beyond_the_wall, quantile, to_the_wall
from nontwist.fitting.unknowns import TRACELESS, Model, entries
from nontwist.recordings.headers import ACCELEROMETER, GYROSCOPE, rate_unit
from nontwist.recordings.headers import sensors as three_axes
from nontwist.recordings.reading import Rates
from nontwist.runfile import read_run_file
from refusals import refused, refused_as, said, warned

PHONE = nt.inertia.of_cuboid(0.18, (0.147, 0.072, 0.008))
W = np.array([8.0, 9.0, -7.0])


@cache
def throw(seed=0, rate=400, phone=True):
    """A recording of a free body: J of trace 1, and what the gyroscope reads."""
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    inertia = turned @ (PHONE if phone else np.diag([1, 1.7, 2.3])) @ turned.T
    start = rng.normal(size=3)
    start *= rng.uniform(8, 16) / np.linalg.norm(start)
    read = recorded(nt.standard(inertia), 0.6, start, sensor={"rate": rate, "seed": seed} | off_by(rng))
    return inertia / np.trace(inertia), read


@cache
def hand(seed=1):
    """Times and angular velocities of a phone that is thrown at 0.75 s, caught at 1.35 s."""
    rng = np.random.default_rng(seed)
    t, moments = np.array([0, 0.5, 0.6, 0.7, 0.75]), np.zeros((5, 3))
    moments[2:4] = rng.normal(size=(2, 3)) * [[90], [60]] @ PHONE
    how = {"load": nt.body_moment(t, moments), "material_angular_velocity": (0.3, 0.2, -0.1)}
    run = nt.simulate(nt.standard(PHONE), t_end=1.35, step=1 / 2000, **how)
    flight = nt.sensors.gyroscope(run, noise=1.2e-4, bias=(0.01, 0.02, -0.01), scale=1.005, rate=400, seed=seed)
    after = np.arange(1, 81) / 400
    caught = flight.gyroscope.values[-1] * np.exp(-after / 0.05)[:, None] + 0.002 * rng.normal(size=(80, 3))
    time = np.concatenate([flight.time.values, 1.35 + after])
    return time, np.concatenate([flight.gyroscope.values, caught])


HEADER = "time (s),gyr_x (deg/s),gyr_y (deg/s),gyr_z (deg/s)"


def in_degrees(path, time, rates, header=HEADER, *more):
    return csv(path, header, time, np.degrees(rates), *more)


# The model


def test_runaway_motion_is_given_up():
    with pytest.raises(RunawayError, match="not finite, or needs too many steps"):
        responses(Motion(Model(damping=1), FREE, np.array([-30.0])), [Track(W, np.linspace(0, 2, 300))])


# Estimates


def test_errors_match_intervals():
    deviations = []
    for seed in range(4):
        inertia, recording = throw(seed, rate=(100, 400)[seed % 2], phone=seed % 3 == 0)
        deviations.append(off(whole(recording), inertia))
    assert_as_wide(deviations)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the recording does not determine")
def test_coverage_of_intervals():
    throws = (throw(seed, rate=100, phone=seed % 2 == 0) for seed in range(100, 220))
    fits = ((whole(recording), inertia) for inertia, recording in throws)
    assert 0.91 < share_covered(fits) < 0.99  # three standard errors of a share of 120


def test_several_recordings():
    rng, recordings = np.random.default_rng(8), []
    for seed, thickness in enumerate((0.008, 0.008, 0.012)):
        body = nt.standard(nt.inertia.of_cuboid(0.18, (0.147, 0.072, thickness)))
        sensor = {"noise": 5e-4, "bias": (0.01, 0, 0), "rate": 100, "seed": seed}
        recordings.append(recorded(body, 0.6, 7 * rng.normal(size=3), sensor=sensor))
    together, *alone = (whole(recordings[some]) for some in (slice(2), 0, 1))
    assert farthest(together, PHONE / np.trace(PHONE)) < 4
    assert together.identifiable[-1].standard_error < min(one.identifiable[-1].standard_error for one in alone)
    assert abs(together.cross_validation - 1).max() < 0.15
    assert alone[0].cross_validation.size == 0
    with pytest.warns(UserWarning, match=r"^the residuals are \S+ times what noise explains: "):
        fit = whole(recordings)
    assert fit.plot(1).get_title() == "data and model: recording 2"
    assert fit.cross_validation[2] > 2 > fit.cross_validation[:2].max()


def test_uneven_times_and_bad_rows():
    inertia, recording = throw(5)
    t, y = recording.time.values, recording.gyroscope.values.copy()
    y[7, 1] = np.nan
    order = np.random.default_rng(0).permutation(np.delete(np.arange(len(t)), np.arange(100, 140)))
    with warned("missing-rates", "unsorted-times", "gaps") as told:
        fit = whole((t[order], y[order]))
    assert farthest(fit, inertia) < 4
    assert fit.parts[0].left_out == 1
    assert {one.within for one in told} == {"the recording"}
    ends = {name: f"row {np.flatnonzero(order == k)[0]}" for name, k in (("first", 99), ("last", 140))}
    found = told[2].fields
    assert found.items() >= (ends | {"gaps": "1 gap"}).items()
    assert found["step"] == pytest.approx(0.1025)


def test_robust_loss():
    inertia, recording = throw(6)
    t, y, true = recording.time.values, recording.gyroscope.values.copy(), np.linalg.eigvalsh(inertia)
    y[::29] += 0.3
    robust = whole((t, y), loss="soft_l1", noise=2e-3)
    assert farthest(robust, inertia) < 5
    with pytest.warns(UserWarning, match="times the noise off: an impact"):
        plain = whole((t, y))
    wrong = [abs(fit.principal.moments - true).max() for fit in (plain, robust)]
    assert wrong[0] > 3 * wrong[1]


def test_interval_at_the_wall():
    sensor = {"noise": 4e-3, "rate": 100, "seed": 3}
    fit = whole(recorded(nt.standard(PHONE), 0.6, (2, 9, 3), sensor=sensor))
    low, high = fit.principal.intervals[2]
    assert high == 0.5
    assert low < np.linalg.eigvalsh(PHONE)[2] / np.trace(PHONE) < high
    assert fit.table()["J3 / sum"].endswith(" to 0.50000)")
    far = whole(throw(1, phone=False)[1])  # where the profile is the normal interval
    profile = to_the_wall(far.solution, quantile(far.solution), far.covariance)
    np.testing.assert_allclose(profile, far.principal.intervals[2], atol=2e-5)
    run = nt.simulate(nt.standard([1, 2, 3]), t_end=2, material_angular_velocity=(0.1, 0.5, 1))  # flat, without noise
    assert np.allclose(nt.fit_inertia(run).principal.intervals[2], 0.5, rtol=0, atol=1e-9)


# What cannot be told


def test_steady_spin_gives_the_axis(here):
    recording = recorded(nt.standard([1, 2, 2.5]), 0.6, (0, 0, 12), sensor={"rate": 100})
    with pytest.warns(UserWarning, match=r"^the recording does not determine .* axis, or longer$"):
        fit = nt.fit_inertia(recording)
    assert len(fit.untold) == 3
    assert np.isnan(fit.principal.moments).all()
    assert np.isnan(fit.principal.intervals).all()
    assert abs(fit.inertia[[0, 1], 2]).max() < 1e-3
    assert np.isnan(fit.inertia[[0, 1, 2, 0], [0, 1, 2, 1]]).all()
    assert "turn it about a second axis" in fit.table()["undetermined"]
    assert beyond_the_wall(fit.solution) == 0
    by = entries(fit.untold[-1].matrix) * [1, 1, 1, 2, 2, 2]
    assert by @ fit.covariance @ by == pytest.approx(1e4)  # as moments are parts of their sum
    run = nt.simulate(nt.standard([1, 1, 2]), t_end=2, material_angular_velocity=(5, 0.1, 0))
    with pytest.warns(UserWarning, match="does not determine"):  # W3 is constant: no sensor is at its limit
        assert len(nt.fit_inertia(run).untold) == 3
    with pytest.raises(ValueError, match="does not determine the whole inertia"):
        fit.problem()
    assert len(fit.plot().figure.axes) == 3
    in_degrees("spin.csv", recording.time.values, recording.gyroscope.values)
    result = ended(3, "fit", "spin.csv", "--out", "body.toml")
    assert "undetermined" in result.stdout
    assert "not written: body.toml, because the recordings do not determine the inertia" in result.stderr
    assert not (here / "body.toml").exists()


def test_directions_are_principal_axes():
    """And have the errors of the inverse of all information."""
    fit = whole(throw(2)[1])
    found = fit.solution
    _, slope = stacked([*found.residuals.rates, *found.residuals.beside], found.problem.columns)
    A = np.concatenate([slope[:, :6] @ TRACELESS, slope[:, 6:]], axis=1)
    scale = np.linalg.norm(A, axis=0)
    full = (np.linalg.inv((A / scale).T @ (A / scale)) / np.outer(scale, scale))[:5, :5]
    np.testing.assert_allclose(np.linalg.inv(found.information), full, rtol=1e-4)
    gram = np.array([[np.sum(a.matrix * b.matrix) for a in fit.identifiable] for b in fit.identifiable])
    np.testing.assert_allclose(gram, np.eye(5), atol=1e-12)
    errors = [one.standard_error for one in fit.identifiable]
    assert errors == sorted(errors)
    for one in fit.identifiable:
        along = TRACELESS.T @ (entries(one.matrix) * [1, 1, 1, 2, 2, 2])
        assert np.sqrt(1 / (along @ fit.solution.information @ along)) == pytest.approx(one.standard_error)
        assert one.name.startswith(("the principal moment ", "the difference of the ", "the directions of the "))
    panels = {ax.get_title(): ax for ax in fit.plot().figure.axes}
    said("; ".join(panels))
    (bars,) = panels["principal moments"].containers[0].lines[2]
    assert np.array(bars.get_segments())[:, :, 1] == pytest.approx(fit.principal.intervals)


# The interval


def test_flight_between_release_and_catch():
    fit = nt.fit_inertia(hand(5))
    (part,) = fit.parts
    assert part.interval == "the smallest residual"
    assert 0.74 <= part.time[0] <= 0.79
    assert 1.31 <= part.time[-1] <= 1.35
    assert farthest(fit, PHONE / np.trace(PHONE)) < 4


def test_fall_in_either_unit():
    time, read = np.arange(100) / 100, np.tile([0, 0, 1.0], (100, 1))
    read[30:60] *= 0.1
    assert [falls(time, unit * read) for unit in (1.0, 9.81)] == [[(30, 60)]] * 2


# What is said of bad recordings


def free_part(factor=1.0):
    time, rates = hand()
    free = (time > 0.76) & (time < 1.34)
    return time[free], factor * rates[free]


def not_a_body(noise=1e-3, moments=(0.2, 0.29, 0.51)):
    """Rates that obey Euler's equations of J3 > J1 + J2."""
    body, sensor = nt.standard(moments, physical=False), {"noise": noise * np.sqrt(2 / 400), "rate": 400}
    found = recorded(body, 239 / 400, (4.0, 6.0, 9.0), sensor=sensor)
    return found.time.values, found.gyroscope.values


def wandering():
    return np.arange(600) / 100, np.cumsum(np.random.default_rng(0).normal(size=(600, 3)), axis=0)


test_bad_recordings_are_refused = refused_as(
    {
        "slow": lambda: nt.fit_inertia(free_part(1 / 60)),
        "coarse": lambda: nt.fit_inertia(free_part(60)),
        "short": lambda: nt.fit_inertia(tuple(one[:11] for one in free_part())),
        "saturated": lambda: whole((free_part()[0], np.maximum(free_part()[1], -12.768))),
        "a hand": lambda: whole(hand()),
        "two bodies": lambda: whole([throw(4)[1], throw(4, phone=False)[1]]),
        "not in it": lambda: nt.fit_inertia(hand(), interval=(3, 4)),
        "empty interval": lambda: nt.fit_inertia(hand(), interval=(1, 1)),
        "unknown interval": lambda: nt.fit_inertia(hand(), interval="flight"),
        "no motion": lambda: nt.fit_inertia(wandering()),
        "no body": lambda: whole(not_a_body()),
        "far from a body": lambda: nt.fit_inertia(not_a_body(moments=(0.05, 0.12, 0.5))),
        "no recording": lambda: nt.fit_inertia([]),
        "a number": lambda: nt.fit_inertia(3),
        "shapes": lambda: nt.fit_inertia((np.arange(40), np.zeros((3, 3)))),
        "loss": lambda: nt.fit_inertia(throw()[1], loss="huber"),
        "bias": lambda: nt.fit_inertia(throw()[1], bias=0),
        "physical": lambda: nt.fit_inertia(throw()[1], physical=1),
        "plot": lambda: whole(throw(1)[1]).plot(1),
    }
)


def test_saturated_gyroscope_of_slow_body():
    time, rates = free_part()
    with pytest.raises(ValueError, match="the gyroscope is saturated"):
        whole((30 * time, np.maximum(rates, -12.768) / 30))


@pytest.mark.parametrize("step", [0.005, 0.02, 0.05])
def test_coarse_peaks_are_not_saturated(step):
    """Where 4 to 10 readings in a row are the largest, as at the top of a smooth rate."""
    time, rates = free_part()
    assert farthest(whole((time, np.round(rates / step) * step)), PHONE / np.trace(PHONE)) < 4


def test_zeros_amid_motion_are_lost():
    """Three rows of them in a row; not those at an end, nor of a body at rest before it is thrown."""
    time, rates = free_part()
    rates = np.where(np.isin(np.arange(231), [40, 41, 42, 230])[:, None], 0, rates)
    found = Rates(time, rates, "it", ()).cleaned()
    assert np.array_equal(found.time, np.delete(time, [40, 41, 42]))
    assert [(one.code, one.fields["rows"]) for one in found.warnings] == [("missing-rates", "3 rows")]
    slow = np.outer(np.maximum(abs(time - time[115]) - 0.1, 0), [1, 2, 3])
    assert not Rates(time, slow, "it", ()).cleaned().left_out


def test_twelve_samples_are_enough():
    require_turning(Model(), np.arange(12.0), np.tile([0, 0, 0.1], (12, 1)), "it")


def test_unphysical_inertia_where_allowed(here):
    fit = whole(not_a_body(), physical=False)
    assert farthest(fit, np.diag([0.2, 0.29, 0.51])) < 4
    assert fit.is_explained
    assert apart(fit) < 1e-6
    in_degrees("water.csv", *not_a_body())
    ended(0, "fit", "water.csv", "--all", "--unphysical", "--out", "water.toml")
    assert apart(fit, nt.Problem.read("water.toml")) < 1e-3
    recording = throw(1, phone=False)[1]
    found = [whole(recording, physical=one).principal.moments for one in (True, False)]
    np.testing.assert_allclose(*found, atol=1e-6)  # where bodies are, it makes no difference


# Files


UNITS = {
    "deg/s": ["Gyroscope {1} (deg/s)", "g{0} (°/s)", "w{0}_dps"],
    "rad/s": ["gyr_{0} [rad/s]", "Gyro{1} [rad·s⁻¹]", "g{0}_rad_s", "g{0} (rad s^-1)", "w{1} (radians/second)"],
    "mdeg/s": ["gyro {0} (mdps)"],
    "rpm": ["omega_{0} (rpm)"],
    None: ["g{0}", "g{0} (g)"],
}


@pytest.mark.parametrize(("unit", "header"), [(unit, one) for unit, headers in UNITS.items() for one in headers])
def test_gyroscopes_by_headers(header, unit):
    three = tuple(header.format(x, x.upper()) for x in "xyz")
    accelerations = "ax", "ay", "az"
    for what, columns in ((GYROSCOPE, three), (ACCELEROMETER, accelerations)):
        assert [one[1] for one in three_axes(["time", *three, *accelerations], what)] == [columns]
    assert {rate_unit(f"{one}{number}") for one in three for number in ("", ".1")} == {unit}


OF_FILES = {"unit": "deg/s", "rate": 400, "columns": ["a", "b", "c"], "body": "a", "time_unit": "ms"}


def test_files_say_what_they_are(tmp_path):
    time, rates = free_part()

    def written(header, time=time):
        return in_degrees(tmp_path / f"{len(header)}.csv", time, rates, header)

    fit = whole(written(HEADER))
    assert fit.parts[0].notes == (
        "angular velocity: gyr_x (deg/s), gyr_y (deg/s), gyr_z (deg/s), deg/s",
        "time: column 'time (s)', s",
    )
    bare, named = written("time (s),gx,gy,gz"), written("when,a,b,c")
    timeless = written("n,gx (deg/s),gy (deg/s),gz (deg/s)", 0 * time)
    for source, how in ((bare, {"unit": "°/s"}), (named, {"columns": ["when", "a", "b", "c"], "unit": "deg/s"})):
        assert np.array_equal(whole(source, **how).inertia, fit.inertia)
    assert abs(whole(timeless, rate=400).inertia - fit.inertia).max() < 1e-7
    assert np.array_equal(whole(pandas.read_csv(bare), unit="deg/s").inertia, fit.inertia)
    for source, code, how in (
        (bare, "no-unit", {}),
        (pandas.read_csv(bare), "no-unit", {}),
        (bare, "unit", {"unit": "furlongs"}),
        (bare, "no-bodies", {"unit": "deg/s", "body": "thigh"}),
        (named, "no-gyroscope", {}),
        (named, "no-column", {"columns": ["a", "b", "d"]}),
        (timeless, "no-time", {}),
        *(((time, rates), "option-without-effect", {name: one}) for name, one in OF_FILES.items()),
    ):
        with refused(code):
            nt.fit_inertia(source, **how)


def test_runs_are_recordings(tmp_path):
    run = nt.simulate(nt.standard([1, 2, 2.5]), t_end=1, step=0.005, material_angular_velocity=(3, 8, 1))
    nt.save_run(run, tmp_path / "run.nc")
    with refused("option-without-effect", name="unit"):
        nt.fit_inertia(tmp_path / "run.nc", unit="deg/s")
    of_run, of_file = (fit(one).principal.moments for fit, one in ((nt.fit_inertia, run), (whole, tmp_path / "run.nc")))
    assert np.array_equal(of_file, of_run)  # a free recording is taken whole
    assert abs(of_run - np.array([1, 2, 2.5]) / 5.5).max() < 1e-5


@pytest.mark.usefixtures("here")
def test_the_command():
    text = Path(in_degrees("throw.csv", *hand())).read_text(encoding="utf-8")
    how = ["--json", "--out", "body.toml", "--figure", "fit.png"]
    numbers = json.loads(ended(0, "fit", "throw.csv", *how).stdout)
    np.testing.assert_allclose(numbers["moments"], np.linalg.eigvalsh(PHONE) / np.trace(PHONE), atol=2e-3)
    assert numbers["recordings"][0]["name"] == "throw.csv"
    assert len(numbers["identifiable"]) == 5
    found = read_run_file("body.toml")
    np.testing.assert_allclose(found.body.inertia, numbers["inertia"])
    assert found.title == "Motion as fitted; moments of inertia in parts of their sum"
    assert Path("fit.png").stat().st_size > 10_000
    part = ["--from", "0.8", "--to", "1.3"]
    table = ended(0, "fit", "throw.csv", *part).stdout
    assert "as given" in table
    assert "J1 / sum" in table
    assert "free motion determines ratios only" in table
    assert " rows dropped" not in table
    in_degrees("other.csv", *hand(5))
    assert "cross-validation" in ended(0, "fit", "throw.csv", "other.csv", *part).stdout
    Path("plain.csv").write_text(text.replace(" (deg/s)", ""), encoding="utf-8")
    for status, given, words in (
        (2, "throw.csv --from 0.8", ""),
        (2, "throw.csv --from 0.8 --to 0.3", "--to: must be after --from, 0.8, got 0.3"),
        (2, "throw.csv --all --from 0 --to 1", ""),
        (2, "throw.csv -", ""),
        (5, "nothing.csv", ""),
        (3, "throw.csv --unit rad/s", "state deg/s, but --unit is rad/s; omit it, or rename the columns\n"),
        (3, "plain.csv --unit rad/s", "or are rates in deg/s, or times in ms?"),
    ):
        stderr = ended(status, "fit", *given.split()).stderr
        assert words in stderr
        assert "Traceback" not in stderr


# The sensor


def test_noise_density_of_data_sheet():
    found = sensed((0, 0, 0), 100, 0.01, noise=2e-3, seed=5).gyroscope.values
    assert np.std(found) == pytest.approx(2e-3 * np.sqrt(100 / 2), rel=0.02)
    assert noise_of(found) == pytest.approx(np.std(found), rel=0.05)
    assert noise_of(found[:13]) == 0 < noise_of(found[:14])
    assert abs(correlation(found)) < 4 / np.sqrt(found.size)  # so that it is the same at all frequencies
    again = [sensed((0, 0, 0), 100, 0.01, noise=2e-3, seed=seed).gyroscope.values for seed in (5, 6)]
    assert [np.array_equal(found, one) for one in again] == [True, False]


def sensed(start=W, seconds=1, step=0.1, **how):
    return nt.sensors.gyroscope(
        nt.simulate(nt.standard(FREE), t_end=seconds, step=step, material_angular_velocity=start), **how
    )


test_wrong_sensors = refused_as(
    {
        "noise": lambda: sensed(noise=-1),
        "scale": lambda: sensed(scale=0),
        "rate": lambda: sensed(rate=0.5),
        "delay": lambda: sensed(delay=-0.01),
        "delay without a rate": lambda: sensed(delay=0.01),
        "a short run, delayed": lambda: sensed(seconds=0.5, rate=4, delay=0.4),
        "uneven": lambda: nt.sensors.gyroscope(nt.simulate(nt.standard(FREE), t_end=1, times=[0, 0.1, 0.5]), noise=1),
    }
)


def test_axes_that_nothing_tells():
    """A turn about one axis: variances that round-off makes negative are those of axes that are not told."""
    how = {"t_end": 1, "step": 0.05, "material_angular_velocity": (0.5, 2, 0)}
    with pytest.warns(match="does not determine"):
        fit = nt.fit_inertia(nt.simulate(nt.nontwisting([3, 4, 5]), **how), interval="all")
    assert np.isnan(fit.principal.tilts).all()  # and without a warning of NumPy
    assert len(fit.warnings) == 1  # round-off is no impact


def test_printed_digits():
    assert number_in_words(0.2, (0.1, 0.3)) == "0.20 (0.10 to 0.30)"
    assert number_in_words(12.3456, (12.343, 12.347), " s") == "12.3456 (12.3430 to 12.3470) s"
    assert number_in_words(0.0, (-1e-5, 1e-5)) == "0.0e+00 (-1.0e-05 to 1.0e-05)"
    assert number_in_words(2.0, (1.0, np.inf)) == "2, without an interval"
