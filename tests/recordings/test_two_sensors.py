"""The twist of a joint from two recordings: clocks, rates, mountings, against the closed form.

The joint is Rz(φ) Ry(θ) Rz(ψ) with θ fixed: its axis goes around a cone, and its twist is ψ + φ cos θ. Both sensors are
shaken together at the start and at the end while the joint is at rest, as a protocol asks for.
"""

import json
import re
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas
import pytest
import xarray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from conftest import ended
from nontwist import open_run, twist
from nontwist.errors import InputError
from nontwist.recordings.relative import SURE, VAGUE, fitted_clock, speed_correlation
from refusals import refused, warned

LONG, TILT = pytest.mark.long, 0.9
T = np.arange(100) / 50


def bump(t, centre, width):
    return (1 - np.clip((t - centre) / width, -1, 1) ** 2) ** 4


def tempi(seed, count):
    """Factors of frequencies, 1 without a seed."""
    return np.ones(count) if seed is None else np.random.default_rng(seed).uniform(0.7, 1.4, count)


def upper(t, end, shakes=2, seed=None):
    """The attitude of the upper arm, shaken at the start and at the end, or at the start alone."""
    move, f = bump(t, end / 2, end / 2 - 7), tempi(seed, 6)
    shake = sum(
        np.sin(9 * f[0] * (t - c)) * bump(t, c, 2.5) + 0.6 * np.sin(14 * f[1] * (t - c) + 0.5) * bump(t, c + 0.6, 1)
        for c in (3, end - 3)[:shakes]
    )
    first = move * (0.6 * np.sin(1.1 * f[2] * t) + 0.3 * np.sin(2.7 * f[3] * t))
    second, third = move * 0.5 * np.sin(1.7 * f[4] * t + 1) + shake, 0.4 * move * np.sin(0.9 * f[5] * t)
    return Rotation.from_euler("ZYX", np.stack([first, second, third], axis=1))


def joint(t, end, tilt=TILT, seed=None):
    """The attitude of the forearm in the upper arm, and its twist about its own z."""
    move, f = bump(t, end / 2, end / 2 - 7), tempi(None if seed is None else seed + 1000, 2)
    phi, psi = 0.4 * move * np.sin(0.7 * f[0] * t), 0.4 * move * np.sin(1.3 * f[1] * t)
    motion = Rotation.from_euler("ZYZ", np.stack([phi, np.full_like(t, tilt), psi], axis=1))
    return motion, psi + phi * np.cos(tilt)


MOUNTED = Rotation.from_rotvec([0.4, -1.1, 0.7])


def noisy(rotation, sigma, seed):
    errors = sigma * np.random.default_rng(seed).standard_normal((len(rotation), 3))
    return rotation * Rotation.from_rotvec(errors)


class Trial(NamedTuple):
    """Times and attitudes of the forearm, the same of the upper arm by its own clock, and the true twist."""

    t: Any
    fore: Rotation
    s: Any
    arm: Rotation
    psi: Any

    def twist(self, **options):
        return twist(self.fore, self.t, relative_to=self.arm, relative_time=self.s, **options)

    def noisy(self, sigma, seed):
        return self._replace(fore=noisy(self.fore, sigma, seed), arm=noisy(self.arm, sigma, seed + 1))

    def fit(self, drift=False, shake=None):
        return fitted_clock(self.fore, self.t, self.arm, self.s, drift=drift, shake=shake)

    def off(self, found):
        """By how much a twist is wrong, at most, from its first time on, in degrees."""
        error = found.twist_angle.values - self.psi[np.searchsorted(self.t, found.time.values)]
        return np.degrees(abs(error - error[0]).max())


def recordings(end, rates, drift=0.0, late=0.3, shakes=2, seed=None):
    """The second clock has a drift, and is late by 0.3 s less than said."""
    t, true = np.arange(0, end, 1 / rates[0]), np.arange(0.3, end + 2, 1 / rates[1])
    s = late + (true - true[0]) / (1 + drift)
    turned, psi = joint(t, end, seed=seed)
    return Trial(t, upper(t, end, shakes, seed) * turned, s, upper(true, end, shakes, seed) * MOUNTED, psi)


# seconds; rates, Hz; drift; what is added to the second clock, s; tolerances of shift, s, drift, and twist, degrees
CASES = {
    "one clock": (60, (100, 100), 0.0, 0.3, "shift", 1e-6, 0, 1e-6),
    "another rate": (60, (100, 61.7), 0.0, -5.0, "shift", 1e-5, 0, 1e-5),
    "a drift": (120, (50, 60), -200e-6, 7.0, "drift", 2e-3, 2e-6, 1e-1),
}
ALIGNED = re.compile(r"shifted by (\S+) s(?: at its first sample, drift (\S+) ± (\S+) ppm)? \(")


@pytest.mark.filterwarnings("ignore:dropped .* that the second recording does not cover")
@pytest.mark.parametrize("case", CASES)
def test_clocks_are_found(case):
    end, rates, drift, late, clocks, of_shift, of_drift, of_twist = CASES[case]
    trial = recordings(end, rates, drift, late)
    found = trial.twist(clocks=clocks)
    told = ALIGNED.search(found.attrs["alignment"])
    assert float(told[1]) == pytest.approx(0.3 - late, abs=of_shift)
    if clocks == "drift":
        assert 1e-6 * float(told[2]) == pytest.approx(drift, abs=of_drift)
        assert float(told[3]) < 10
    assert trial.off(found) < of_twist


def test_moving_from_the_start():
    """Between the samples of an arm that speeds up at both ends the order is 4, as everywhere."""
    t, off = np.linspace(0.01, 1.99, 2001), []
    psi, phi = np.sin(2.3 * t), 0.7 * np.sin(1.9 * t)
    turned = Rotation.from_euler("ZYZ", np.stack([phi, np.full_like(t, TILT), psi], axis=1))
    for count in (41, 81, 161):
        s = np.linspace(0, 2, count)
        arms = [Rotation.from_euler("ZYX", np.stack([3 * x, 0.8 * np.sin(4 * x), x**3], axis=1)) for x in (t, s)]
        off.append(Trial(t, arms[0] * turned, s, arms[1], psi + phi * np.cos(TILT)))
    errors = [trial.off(trial.twist(clocks="shared")) for trial in off]
    assert np.log2(np.divide(errors[:-1], errors[1:])).min() > 3.5
    assert errors[-1] < 1e-4


def drift_found(end, drift, shakes, seed, sigma):
    """The error of the drift that is found, and how uncertain it is said to be."""
    trial = recordings(end, (100, 61.7 if seed % 2 else 100), drift, 10.0, shakes, seed)
    fit = trial.noisy(sigma, seed).fit(drift=True)
    return fit.drift - drift, fit.unsure


QUICK = [(30, 100e-6, 2e-3, [0]), (60, -200e-6, 3e-4, [1])]
EVERY = product([30, 60, 180], [100e-6, -200e-6], [0, 3e-4, 2e-3], [range(12)])


@pytest.mark.parametrize(("end", "drift", "sigma", "seeds"), [*QUICK, *(pytest.param(*x, marks=LONG) for x in EVERY)])
def test_drift_needs_both_ends(end, drift, sigma, seeds):
    for seed in seeds:
        if (end, drift, sigma, seed) == (180, 100e-6, 2e-3, 2):  # the speeds are less alike than is asked for
            with refused("unlike-speeds"):
                drift_found(end, drift, 2, seed, sigma)
            continue
        error, unsure = drift_found(end, drift, 2, seed, sigma)
        assert abs(error) < 15e-6
        assert abs(error) < 3 * unsure < 3 * VAGUE
        with pytest.raises(InputError) as told:
            drift_found(end, drift, 1, seed, sigma)
        assert told.value.code in ("uncertain-drift", "unlike-speeds")
        assert not told.value.fields.get("ppm", np.inf) <= 1e6 * VAGUE


@pytest.mark.parametrize(("drift", "seed"), [(500e-6, 0), pytest.param(-800e-6, 2, marks=LONG)])
def test_large_drift(drift, seed):
    """By 0.5 s at the end, several periods of a shake: the drift that fits best nearby is wrong by 500 ppm or more."""
    error, unsure = drift_found(600, drift, 2, seed, 0)
    assert abs(error) < 1e-6
    assert unsure < 2e-6


def test_uncertainty_of_drift():
    """Both sensors move for the first third alone."""
    t = np.arange(0, 90, 0.01)
    arm = Rotation.from_rotvec(np.outer(bump(t, 15, 12) * np.sin(2 * t + 0.1 * t**2), [0.3, 0.2, 0.5]))
    trial = Trial(t, arm, t + 3, arm, None)
    fit = trial.noisy(1e-7, 1).fit(drift=True)
    assert abs(fit.drift) < 3 * fit.unsure < 1e-7
    with refused("uncertain-drift"):
        trial.noisy(1e-3, 1).fit(drift=True)


def test_constant_speeds():
    t = np.arange(0, 20, 0.01)
    for steady in (Rotation.identity(t.size), Rotation.from_rotvec(np.outer(t, [0.1, 0.2, 0.3]))):
        with refused("steady-speeds"):
            Trial(t, steady, t + 3, steady, None).twist(clocks="drift")


def test_times_on_one_clock():
    errors = []
    for rate in (40, 80):
        trial = recordings(20, (200, rate))
        inside = trial.t >= 0.3
        trial = trial._replace(t=trial.t[inside], fore=trial.fore[inside], psi=trial.psi[inside])
        errors.append(np.radians(trial.off(trial.twist())))
    assert errors[0] / errors[1] > 2**3
    assert errors[1] < 1e-4


@pytest.mark.parametrize("start", ["2026-01-01", "2026-01-01 02:00+01:00", "26:00:00"])
def test_dates_and_durations(start):
    t, fore, s, arm, psi = recordings(20, (200, 80))
    first = (pandas.Timedelta if "26:" in start else pandas.Timestamp)(start)
    one, other = ([*map(first.__add__, pandas.to_timedelta(x, unit="s"))] for x in (t[60:], s))
    fore, one, other = fore[60:].as_quat(), pandas.Series(one), pandas.Series([None, *other])
    arm = np.concatenate([np.zeros((1, 4)), arm.as_quat()])  # lost, and so is its time
    table = pandas.DataFrame(fore, columns=["qx", "qy", "qz", "qw"]).assign(time=one)
    for motion, time in ((fore, one), (table, None), *([(fore, [*one])] if "+" in start else [])):
        with warned("missing-rows"):
            found = twist(motion, time, relative_to=arm, relative_time=other, scalar_first=False)
        assert found.twist_angle.values == pytest.approx(psi[60:] - psi[60], abs=1e-4)


def test_units_of_times():
    q, time = Rotation.from_rotvec(np.outer(T, [0, 0, 1])).as_quat(), ("time", 1e3 * T, {"units": "ms"})
    assert twist(xarray.DataArray(q, {"time": time}, ("time", "quat"))).twist_rate.values == pytest.approx(1)


def test_static_alignment():
    """In the pose at rest forearm and upper arm hang along the vertical; the sensors are strapped on anyhow."""
    t = np.arange(0, 20, 1 / 200)
    move = bump(t, 11, 7.0)
    swing, psi = 0.8 * move * np.sin(1.1 * t), 0.7 * move * np.sin(1.7 * t)
    turned = Rotation.from_euler("YZ", np.stack([swing, psi], axis=1))  # along a great circle: its twist is ψ
    arm = Rotation.from_euler("XY", np.stack([0.5 * move * np.sin(0.9 * t), 0.3 * move], axis=1))
    fore, two = arm * turned * Rotation.from_rotvec([1.2, 0.3, -0.8]), {"relative_to": arm * MOUNTED}
    found = twist(fore, t, **two, align="static")
    given = twist(fore, t, **two, align="static", static=(0, 2))
    alone = twist(turned * MOUNTED, t, align="static")
    for one in (found, given, alone):
        assert one.twist_angle.values == pytest.approx(psi, abs=1e-7)
    told = re.search(r"static pose chosen, from \S+ to (\S+) s, which moves by up to (\S+)°", found.attrs["alignment"])
    assert (float(told[1]) < 3.1, float(told[2]) < 1e-5) == (True, True)
    assert abs(twist(fore, t, **two).twist_angle.values - psi).max() > 0.1
    restless = Rotation.from_rotvec(np.outer(np.sin(3 * t), [0.3, 0.2, 0.5]))
    for moving in ({"relative_to": arm, "static": (8, 12)}, {"relative_to": restless}):
        with warned("pose-moves"):
            twist(fore, t, align="static", **moving)
    for own in ({"static": (0, 2)}, {"static": (0, 2), "relative_to": arm}):
        with refused("static-alone"):
            twist(fore, t, **own)


LATE, SHAKES = 4.321, [(1.0, 4.0), (46.0, 49.0)]  # s, of 50 s


def shaken(seed, drift=0.0, together=True, sigma=3e-4, alike=False):
    """Two sensors on an elbow, shaken in SHAKES at its rest.

    It turns by up to 110°/s or more about its axis while the upper arm is nearly still. The second clock is LATE at its
    first sample.
    """
    f = np.random.default_rng(seed).uniform(0.8, 1.3, 12)

    def arm(t, tempi):
        hand = sum(
            bump(t, 2.5 + 45 * k, 1.5) * np.sin(15 * a * t + 1.5 * np.sin(4 * b * t))
            for k, (a, b) in enumerate(tempi.reshape(2, 2))
        )
        return Rotation.from_euler("YX", np.stack([0.35 * hand, 0.05 * bump(t, 25, 19) * np.sin(2 * f[1] * t)], axis=1))

    t, true = np.arange(0, 50, 0.01), np.arange(0.4, 51, 1 / 61.7)
    move = bump(t, 25, 19)
    psi = move * (0.7 * np.sin(2.1 * f[0] * t) + 0.5 * np.sin(4.2 * f[2] * t))
    bent = 0.8 * move * (1 + np.sin(1.7 * f[3] * t))
    if alike:  # tempi that repeat after 45 s
        f[4:8] = 2 * np.pi * np.array([107 / 675, 29 / 180] * 2)
    fore = arm(t, f[4:8] if together else f[8:]) * Rotation.from_euler("YZ", np.stack([bent, psi], axis=1))
    s = true[0] + LATE + (true - true[0]) / (1 + drift)
    return Trial(t, fore, s, arm(true, f[4:8]) * MOUNTED, psi).noisy(sigma, seed)


def test_shift_losing_a_shake():
    """Both shakes are alike: the first one fits the second, but then the second one fits nothing."""
    fit = shaken(1, alike=True).fit(shake=np.array(SHAKES))
    assert fit.shift == pytest.approx(-LATE, abs=2e-4)


def test_gap_in_a_shake():
    trial = shaken(1)
    t, fore, s, arm, _ = trial
    with refused("long-recordings", count=6) as told:
        trial._replace(t=t + 1e6 * (t > 25), s=s + 1e6 * (s > 25 + LATE)).twist(clocks="shift", shake=(1, 4))
    assert told.value.fields["step"] == pytest.approx(0.5, rel=1e-3)
    with refused("long-recordings", count=3):  # of the 24.6 s of the second
        Trial(np.append(t[:-1], 2e7), fore, s[s < 25 + LATE], arm[s < 25 + LATE], None).twist(clocks="shift")


@pytest.mark.parametrize(
    ("clocks", "drift", "seed", "first"),
    [("shift", 0.0, 1, 0), ("shift", 0.0, 1, 1_700_000_000), (None, 0.0, 2, 0), ("drift", -300e-6, 3, 0)],
)
def test_clocks_by_shakes(clocks, drift, seed, first):
    """The motion of the joint alone is refused where a shift is asked for; shifts are stated to 10 µs at any time."""
    trial, shakes = shaken(seed, drift), np.add(SHAKES, first)
    trial = trial._replace(t=trial.t + first)
    if clocks is not None:
        with refused("unlike-speeds", least=0.95):
            trial.twist(clocks=clocks)
    with warned("not-covered") as left_out:
        found = trial.twist(clocks=clocks, shake=shakes if clocks == "drift" else shakes[0])
    assert left_out[0].fields == {"rows": "40 rows"}
    both, words = " and 46 to 49 s" * (clocks == "drift"), found.attrs["alignment"]
    told = ALIGNED.search(words)
    during = re.search(rf"\(correlation of the angular speeds from {first + 1} to {first + 4} s{both}: (\S+)\)$", words)
    assert float(told[1]) == pytest.approx(first - LATE, rel=0, abs=2e-4)
    if clocks == "drift":
        assert abs(float(told[2]) - 1e6 * drift) < 1.5 * float(told[3]) < 15
    assert float(during[1]) > 0.99
    assert trial.off(found) < 0.2  # of noise: 0.02° in each attitude


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 8), marks=LONG)])
def test_independent_motion_gives_no_shift(seeds):
    """Shaken one by one, or named where the joint moves."""
    for seed, count, (together, first) in product(seeds, (1, 2), ((True, 20.0), (False, 1.0), (False, 24.0))):
        shake = np.array([[first, first + 3.0], [first + 10, first + 13]])[:count]
        with refused("unlike-speeds", least=SURE):
            shaken(seed, together=together).fit(count == 2, shake)


def test_short_shake():
    trial = shaken(0, sigma=0)
    with refused("few-shaken", least=50, count=21, other=3123, first=0.0):
        trial.twist(clocks="shift", shake=(2, 2.2))
    with refused("steady-speeds"):
        trial.twist(clocks="shift", shake=(-5, 0.9))


def test_loose_shake():
    trial, shake = shaken(0), np.array([[1.0, 4.0]])
    fit = trial._replace(fore=noisy(trial.fore, 4e-3, 5)).fit(shake=shake)
    assert fit.shift == pytest.approx(-LATE, abs=5e-4)
    with refused("unlike-speeds") as told:
        trial._replace(fore=noisy(trial.fore, 6e-3, 5)).fit(shake=shake)
    assert 0.9 < told.value.fields["correlation"] < SURE


@pytest.mark.parametrize("heading", [0, 2, 20])
def test_headings_of_their_own(heading):
    """Known to 4° from sensors that are shaken together."""
    trial = shaken(1)
    trial = trial._replace(arm=Rotation.from_rotvec([0, 0, np.radians(heading)]) * trial.arm)
    with warned("not-covered", *["spaces-apart"] * (heading > 4)) as told:
        trial.twist(clocks="shift", shake=(1, 4))
    assert [one.fields["angle"] for one in told[1:]] == pytest.approx([heading] * (heading > 4), abs=0.5)


def test_repeating_motion():
    t = np.arange(0, 60, 0.02)
    arm = Rotation.from_rotvec(np.outer(np.sin(2 * t) + 0.1 * np.sin(t), [0.3, 0.2, 0.5]))
    with refused("several-shifts") as told:
        Trial(t, arm, t, arm, None).twist(clocks="shift")
    fields = told.value.fields
    assert abs(fields["apart"]) == pytest.approx(2 * np.pi, abs=0.01)
    assert fields["best"] >= fields["other"] > 0.97


SHAKEN, SHIFT, STATIC = {"shake": (0, 1)}, {"clocks": "shift"}, {"align": "static"}
REFUSED = {
    "no overlap": ({"relative_time": T + 10}, "no-overlap", {"first": 0.0, "last": 1.98, "other_first": 10.0}),
    "few samples": ({"rows": 20, **SHIFT, "relative_time": T}, "few-to-align", {"count": 20, "other": 100}),
    "no times": (SHIFT, "no-times", {}),
    "no pose": ({**STATIC, "static": (7, 8)}, "no-pose", {"first": 7.0, "start": 0.0, "end": 1.98}),
    "rows": ({"rows": 20, "time": None}, "sample-counts", {"other": 100, "count": 20}),
    "drift of one": ({"relative_to": None, "clocks": "drift"}, "one-sensor", {"name": "clocks"}),
    "shake of one": ({"relative_to": None, **SHAKEN}, "one-sensor", {"name": "shake"}),
    "shake of one clock": ({"clocks": "shared", **SHAKEN}, "shake-of-one-clock", {}),
    "clocks": ({"clocks": "both"}, "clocks must be 'shared', 'shift' or 'drift', got 'both'", {}),
    "align": ({"align": "moving"}, "align must be None or 'static', got 'moving'", {}),
    "later": ({**STATIC, "static": (2, 1)}, "static must be two times, the earlier first, got [2.0, 1.0]", {}),
    "later shake": ({"shake": (4, 1)}, "shake must be pairs of times, the earlier first, got [[4.0, 1.0]]", {}),
    "no shake": ({"shake": np.empty((0, 2))}, "shake must be pairs of times, the earlier first, got []", {}),
    "three": ({"shake": (1, 2, 3)}, "shake must have the shape (n, 2), got (3,)", {}),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    options, code, fields = REFUSED[case]
    motion = Rotation.from_rotvec(np.outer(np.sin(T), [0.1, 0.2, 0.3]))
    given = {"time": T, "relative_to": motion, **options}
    rows = slice(given.pop("rows", None))
    given["time"] = None if given["time"] is None else given["time"][rows]
    with pytest.raises(ValueError, match=re.escape(code)) if " " in code else refused(code, **fields):
        twist(motion[rows], **given)


# the command


def dates(time):
    start, whole = np.datetime64("2026-03-01T12:00:00", "ns"), np.round(1e9 * np.asarray(time)).astype(int)
    return start + whole.astype("timedelta64[ns]")


def written(path, rotation, time=None, names="qw qx qy qz", **more):
    columns = dict(zip(names.split(), np.roll(rotation.as_quat(), 1, axis=1).T, strict=True))
    times = {} if time is None else {"time": time}
    pandas.DataFrame({**times, **columns, **more}).to_csv(path, index=False)
    return str(path)


@pytest.fixture
def command(here):
    """The command in an empty folder: on a file, and its result."""
    return lambda *arguments, code=0: ended(code, "twist", "--no-figure", "--force", "--out", "o", *arguments)


@pytest.fixture
def facts(command):
    """What the command says in JSON."""
    return lambda *arguments: json.loads(command(*arguments, "--json").stdout)


def test_command_aligns_clocks(facts):
    """Of dates, the first of which is at 0 s."""
    t, fore, s, arm, _ = shaken(1, -300e-6)
    one, other = written("fore.csv", fore, dates(t)), written("upper.csv", arm, dates(s))
    shakes = ("--shake", "1,4", "--shake", "46,49", "--clocks", "drift")
    told = ALIGNED.search(facts(one, "--relative-to", other, *shakes)["alignment"])
    assert float(told[1]) == pytest.approx(-LATE, abs=2e-4)
    assert float(told[2]) == pytest.approx(-300, abs=15)


@pytest.mark.parametrize(("first", "late"), [(1234.5, 0.0), (0.0, 0.5), (0.0, 0.004)])
def test_times_on_one_axis(command, facts, first, late):
    """Of two files, also where the joint moves as much as the arm, and the speeds match better by another shift."""
    t = np.arange(0, 6, 0.01)
    arm, later = (
        Rotation.from_euler("ZYX", [20, 15, 30] * np.sin(np.outer(s, [1, 1.3, 0.7])), degrees=True)
        for s in (t, t + late)
    )
    psi, covered = 50 * np.sin(1.1 * t), t >= late - 0.005  # half an interval
    bent = np.stack([np.zeros_like(t), 30 * np.sin(2 * t), psi], axis=1)  # along a great circle: its twist is ψ
    one = written("fore.csv", arm * Rotation.from_euler("XYZ", bent, degrees=True), first + t)
    run = (one, "--relative-to", written("upper.csv", later, first + t + late))
    told = facts(*run, *["--clocks", "shared"] * (late == 0.004)).get("alignment", "")
    assert "shifted by" not in told
    assert late != 0.5 or told.startswith(
        "clock of the second recording: times as they are, by which it begins 0.5 s after the "
    )
    assert open_run("o.nc").twist_angle.values == pytest.approx(np.radians(psi - psi[covered][0])[covered], abs=1e-5)
    if late == 0.004:
        asked = command(*run, "--clocks", "shift", code=3).stderr
        assert "the clocks cannot be aligned" in asked
        assert "--clocks shared uses their times unchanged" in asked


def test_two_sensors_in_one_file(command, facts):
    """Named by their columns or, where these are Euler angles, by their bodies."""
    trial = recordings(20, (100, 100))
    arm, names = (upper(trial.t, 20) * MOUNTED).as_quat().T, ("u_qx", "u_qy", "u_qz", "u_qw")
    path = written("both.csv", trial.fore, trial.t, "f_qw f_qx f_qy f_qz", **dict(zip(names, arm, strict=True)))
    columns = ["--columns", "time,f_qw,f_qx,f_qy,f_qz", "--scalar-first", "--relative-columns", "u_qw,u_qx,u_qy,u_qz"]
    assert command(path, *columns, "--quiet").stderr == ""
    assert trial.off(open_run("o.nc")) < 6e-4
    t = np.arange(0, 5, 0.01)
    arm = Rotation.from_euler("ZYX", np.stack([0.3 * np.sin(t), 0.5 * np.cos(2 * t), 0.2 * t], axis=1))
    table = {"time": t}
    for name, motion in (("fore", arm * Rotation.from_euler("z", 0.7 * np.sin(t)[:, None])), ("upper", arm)):
        table |= dict(zip([f"{name}_Euler_{x}" for x in "XYZ"], motion.as_euler("XYZ", degrees=True).T, strict=True))
    pandas.DataFrame(table).to_csv("both.csv", index=False)
    options = ["--euler", "XYZ", "--angle-unit", "deg", "--body", "fore", "--relative-body", "upper"]
    assert facts("both.csv", *options)["twist_angle"] == pytest.approx(0.7 * np.sin(t[-1]), abs=1e-9)


HOUR = 3600.0
DATED = {  # how far the clock of the second file is ahead, what is warned of, and how the clocks are aligned
    "overlap": (0.0, (), "that of the dates of both, by which it begins 1 s after the other"),
    "5.5 h": (5.5 * HOUR, ("time-zones",), ""),
    "-14 h": (-14 * HOUR, ("time-zones",), ""),
    "apart": (-1000.0, (), "shifted by"),
    "another day": (24 * HOUR, (), "shifted by"),  # no zone is so far away
}


@pytest.mark.parametrize("case", DATED)
def test_dates_of_two_files(case):
    """Those that overlap are one clock, beside which it is said what the speeds say; zones differ by half hours.

    Of other dates the speeds tell the shift. The upper arm begins 1 s later than the forearm.
    """
    ahead, codes, aligned = DATED[case]
    trial, true = recordings(20, (100, 100)), np.arange(1.0, 22.0, 0.01)
    dated = Trial(dates(trial.t), trial.fore, dates(true + ahead), upper(true, 20), None)
    with warned(*codes, "not-covered") as said:
        found = dated.twist(clocks=None)
    told = found.attrs["alignment"]
    assert told.startswith(f"clock of the second recording: {aligned}")
    if case == "overlap":
        assert float(re.search(r"\(correlation of the angular speeds (\S+)\)$", told)[1]) > 0.9
    if aligned == "shifted by":
        assert float(ALIGNED.search(told)[1]) == pytest.approx(-ahead, abs=2e-3)
        assert trial.off(found) < 0.11
    else:
        assert trial.off(found) < 6e-5
    if codes:
        assert said[0].fields == {"hours": abs(ahead) / HOUR}
        with refused("no-overlap"):
            dated.twist(clocks="shared")


def test_unlike_speeds():
    t = np.arange(400) / 20
    one, other = (Rotation.from_rotvec(np.outer(np.cumsum(2 + np.sin(w * t)), [0.03, 0.02, 0.04])) for w in (6, 2.2))
    for clocks in (None, "shared"):
        with warned(*["clocks-unlike"] * (clocks is None)):
            Trial(t, one, t + 0.02, other, None).twist(clocks=clocks)


@pytest.mark.parametrize(("late", "is_said"), [(-0.07, False), (0.13, True), (-0.13, True)])
def test_shift_below_a_sample(late, is_said):
    t = np.arange(400) / 20
    arm = Rotation.from_rotvec(np.outer(np.cumsum(3 + np.sin(6 * t + 0.1 * t**2)), [0.03, 0.02, 0.04]))
    with warned(*["clocks-differ"] * is_said, "not-covered") as told:
        Trial(t, arm, t + late, arm, None).twist(clocks=None)
    assert not is_said or told[0].fields["shift"] == pytest.approx(-late)


def test_options_of_the_second_file(command, facts):
    t = np.arange(0, 20, 0.02)
    motion = Rotation.from_euler("ZYX", np.stack([np.sin(t), 0.5 * np.sin(2.3 * t), 0.3 * t], axis=1))
    one, turned = written("one.csv", motion, t), motion * Rotation.from_rotvec([0.3, 0.2, 0.1])
    two = written("two.csv", turned.inv(), np.arange(t.size) * 20, "q0 q1 q2 q3")
    shared = ("--clocks", "shared")
    wrong = command(one, "--relative-to", two, *shared, code=3).stderr
    assert "two.csv: the column 'time' does not state its unit" in wrong
    assert "--time-unit is" in wrong
    assert 'for the second sensor alone: --relative-options "..."' in wrong
    own = "--inverse --scalar-first --time-unit ms"
    found = facts(one, "--relative-to", two, "--relative-options", own, *shared)
    swapped = facts(two, *own.split(), "--relative-to", one, "--relative-options", "", *shared)
    assert max(abs(found["twist_angle"]), abs(swapped["twist_angle"])) < 1e-12
    assert "inverted" not in found["read"]
    assert "scalar first (as given)" in found["relative_to"]
    assert "inverted" in found["relative_to"]


OTHER = ("--relative-to", "{}", "--relative-options")
WRONG_OPTIONS = {
    "no file": (("--relative-options", "--inverse"), "there is no second sensor: --relative-to FILE"),
    "of the first": ((*OTHER, "--axis x"), "--axis is not one of --time-column"),
    "body": ((*OTHER, "--body a"), "--body is not one of"),
    "help": ((*OTHER, "-h"), "nontwist twist -h lists them"),
    "quotes": ((*OTHER, "it's"), "has a quotation mark too few"),
    "unknown": ((*OTHER, "--inverted"), "No such option"),
    "a shake": (("--shake", "1,2"), "Invalid value for --shake: there is no second sensor: --relative-to FILE"),
    "one time": (("--relative-to", "{}", "--shake", "1"), "value for --shake: '1' is not two times like 0,2.5"),
}


@pytest.mark.parametrize("case", WRONG_OPTIONS)
def test_wrong_options(case, command):
    arguments, message = WRONG_OPTIONS[case]
    file = written("one.csv", Rotation.from_rotvec(np.eye(3)), np.arange(3))
    assert message in command(file, *[one.format(file) for one in arguments], code=2).stderr


def test_messages_name_second_options(command):
    t, still = np.arange(5) / 10, Rotation.identity(5)
    one, single = written("one.csv", still, t), written("single.csv", still[:1], t[:1])
    two = written("two.csv", still, t, "a_qw a_qx a_qy a_qz", b_qw=1.0, b_qx=0.0, b_qy=0.0, b_qz=0.0)
    for other, told in (
        (two, "--relative-body takes one of a, b; or name the columns to take: --relative-columns"),
        (single, "the second recording: a twist needs at least 2 samples; 1 of 1 are left"),
    ):
        assert told in command(one, "--relative-to", other, code=3).stderr


def test_options_within_one_file(command, facts):
    t = np.arange(0, 20, 0.02)
    thigh = Rotation.from_euler("ZYX", np.stack([np.sin(t), 0.5 * np.cos(2.3 * t), 0.3 * t], axis=1))
    shank = thigh * Rotation.from_rotvec(np.outer(0.1 * t, [1, 0, 0]))
    savemat("leg.mat", {"t": t, "shank": np.moveaxis(shank.as_matrix(), 0, -1), "thigh": thigh.as_quat()})
    first, last = ("leg.mat", "--axis", "x", "--body"), ("--scalar-last",)
    forth, back = ("shank", "--relative-body", "thigh"), ("thigh", *last, "--relative-body", "shank")
    for lacking in (forth, back):
        assert '; for the second sensor alone: --relative-options "..."' in command(*first, *lacking, code=3).stderr
    for given, own, sign in ((forth, "--scalar-last", 1), (back, "", -1)):
        found = facts(*first, *given, "--relative-options", own)
        assert found["twist_angle"] == pytest.approx(sign * 0.1 * t[-1], abs=1e-9)


def test_gaps_of_the_second_sensor():
    trial = recordings(60, (100, 61.7), late=10.0)
    kept = (trial.s < 30) | (trial.s > 35)
    with warned("gaps", "not-covered") as told:
        found = trial._replace(s=trial.s[kept], arm=trial.arm[kept]).twist(clocks="shift")
    assert (told[0].within, told[0].fields["gaps"], told[1].fields["rows"]) == (
        "the second recording",
        "1 gap",
        "532 rows",
    )
    assert not ((found.time > 20.4) & (found.time < 25.2)).any()
    assert trial.off(found.sel(time=slice(None, 20))) < 0.01


@pytest.mark.parametrize(("factor", "known"), [(0.5, 1), (-0.5, -1)])
def test_correlation_of_common_times(factor, known):
    """Of 2 + f and 2 + c f it is the sign of c, whatever the first one does before and after."""
    t = np.arange(101) / 10
    f = np.where((t[1:] > 3) & (t[1:] < 7), np.sin(3 * t[1:]), 40 * np.cos(t[1:]) ** 2)

    def turning(f):
        return Rotation.from_rotvec(np.outer(np.append(0, np.cumsum(2 + f)) / 100, [0.6, 0, 0.8]))

    a, b, inside = turning(f), turning(factor * f), slice(31, 69)
    assert speed_correlation(a, t, b[inside], t[inside]) == pytest.approx(known, abs=1e-9)
