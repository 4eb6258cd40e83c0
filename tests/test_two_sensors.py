"""The twist of a joint from two recordings: clocks, rates, mountings, against the closed form.

The joint is Rz(φ) Ry(θ) Rz(ψ) with θ fixed: its axis goes around a cone, and its twist is ψ + φ cos θ. Both sensors are
shaken together at the start and at the end while the joint is at rest, as a protocol asks for.
"""

import io
import json
import re
import warnings

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from nontwist import open_run, read_motion, twist
from nontwist.recordings.clocks import SURE, ClockFit, fitted_clock, speed_correlation
from nontwist.cli import app

TILT = 0.9


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


def recordings(end, rates, drift, late, mounting, shakes=2, seed=None):
    """Times and attitudes of the forearm, the same of the upper arm by its own clock, and the true twist."""
    t = np.arange(0, end, 1 / rates[0])
    true = np.arange(0.3, end + 2, 1 / rates[1])
    s = late + (true - true[0]) / (1 + drift)
    turned, expected = joint(t, end, seed=seed)
    arm = upper(true, end, shakes, seed) * mounting
    return t, upper(t, end, shakes, seed) * turned, s, arm, expected, true[0] - late


def noisy(rotation, sigma, seed):
    errors = sigma * np.random.default_rng(seed).standard_normal((len(rotation), 3))
    return rotation * Rotation.from_rotvec(errors)


MOUNTED = Rotation.from_rotvec([0.4, -1.1, 0.7])
# seconds; rates, Hz; drift; what is added to the second clock, s; tolerances of shift, s, drift, and twist, degrees
CASES = {
    "one clock": (60, (100, 100), 0.0, 0.3, "shift", 1e-6, 0, 1e-6),
    "a shift": (60, (100, 100), 0.0, 10.0, "shift", 1e-4, 0, 5e-3),
    "another rate": (60, (100, 61.7), 0.0, -5.0, "shift", 1e-3, 0, 2e-2),
    "a drift": (300, (100, 148.3), 80e-6, 10.0, "drift", 1e-3, 2e-6, 5e-2),
    "a drift of ten minutes": (600, (50, 120), -200e-6, 7.0, "drift", 2e-3, 2e-6, 1e-1),
}


@pytest.mark.parametrize("case", CASES)
def test_clocks_are_found(case):
    end, rates, drift, late, clocks, of_shift, of_drift, of_twist = CASES[case]
    t, fore, s, arm, expected, shift = recordings(end, rates, drift, late, MOUNTED)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"dropped \d+ rows? at times that relative_to does not cover")
        found = twist(fore, t, relative_to=arm, relative_time=s, clocks=clocks)
    told = re.search(
        r"shifted by (\S+) s(?: at its first sample, drift (\S+) ± (\S+) ppm)? \(", found.attrs["alignment"]
    )
    assert float(told[1]) == pytest.approx(shift, abs=of_shift)
    if clocks == "drift":
        assert 1e-6 * float(told[2]) == pytest.approx(drift, abs=of_drift)
        assert float(told[3]) < 10
    at = np.searchsorted(t, found.time.values)
    error = found.twist_angle.values - (expected[at] - expected[at[0]])
    assert np.degrees(abs(error).max()) < of_twist


GUESS = re.compile(
    r"the drift of the clocks is a guess: it is uncertain by (\d+) ppm, which makes (\d\S*) ms over (\d+(?:\.\d+)?) s; "
    r"shake both sensors together at the start and at the end, or use --clocks shift \(clocks='shift'\)"
)
UNDECIDED = (
    "the drift of the clocks is a guess: the angular speeds do not decide it; shake both sensors together at the start "
    "and at the end, or use --clocks shift (clocks='shift')"
)
SEEDS = [range(2), pytest.param(range(2, 12), marks=pytest.mark.long)]


def drift_found(end, drift, shakes, seed, sigma):
    """The error of the drift that is found, how uncertain it is said to be, and the doubts."""
    t, fore, s, arm, *_ = recordings(end, (100, 61.7 if seed % 2 else 100), drift, 10.0, MOUNTED, shakes, seed)
    fit = fitted_clock(noisy(fore, sigma, seed), t, noisy(arm, sigma, seed + 1), s, drift=True)
    return fit.drift - drift, fit.unsure, fit.doubts


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("sigma", [0, 3e-4, 2e-3])
@pytest.mark.parametrize("drift", [100e-6, -200e-6])
@pytest.mark.parametrize("end", [30, 60, 180])
def test_a_drift_is_found_where_both_ends_are_shaken_and_else_said_to_be_a_guess(end, drift, sigma, seeds):
    """No wrong drift without a warning, and no warning where both sensors were shaken together at both ends."""
    for seed in seeds:
        error, unsure, doubts = drift_found(end, drift, 2, seed, sigma)
        assert doubts == ()
        assert abs(error) < 15e-6
        assert abs(error) < 3 * unsure < 90e-6
        error, unsure, doubts = drift_found(end, drift, 1, seed, sigma)
        assert abs(error) < 5 * unsure
        assert abs(drift + error) <= 2e-3
        if not np.isfinite(unsure):
            assert doubts[-1] == UNDECIDED
        elif abs(error) > 50e-6:
            told = GUESS.fullmatch(doubts[-1])
            assert told is not None, doubts
            assert float(told[1]) == pytest.approx(1e6 * unsure, rel=0.06)
            assert float(told[2]) == pytest.approx(1e3 * unsure * float(told[3]), rel=0.06)


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("drift", [800e-6, -800e-6])
def test_a_large_drift_of_a_long_recording_is_found(drift, seed):
    """By 0.5 s at the end, several periods of a shake: the drift that fits best nearby is wrong by 500 ppm or more."""
    error, unsure, doubts = drift_found(600, drift, 2, seed, 0)
    assert abs(error) < 1e-6
    assert unsure < 2e-6
    assert doubts == ()


WINDOWS = np.arange(0, 60, 2.5)  # s, where windows of 5 s match
MATCH = "the angular speeds match in {}, within {} s of {} s"
UNSURE = "it is uncertain by {} ppm, which makes {} ms over {} s"
LIMITS = {
    "sure": (WINDOWS, 5.0, 2e-6, 65.0, 0.01, ""),
    "30 ppm": (WINDOWS, 5.0, 31e-6, 65.0, 0.01, UNSURE.format(31, 2, 65)),
    "a sample": (20 * WINDOWS, 100.0, 20e-6, 1300.0, 0.01, UNSURE.format(20, 26, 1300)),
    "thousands": (WINDOWS, 5.0, 4123e-6, 65.0, 0.01, UNSURE.format(4100, 270, 65)),
    "nothing": (WINDOWS, 5.0, np.inf, 65.0, 0.01, "the angular speeds do not decide it"),
    "no window": (WINDOWS[:0], 5.0, 2e-6, 65.0, 0.01, MATCH.format("0 separate parts", 0, 65)),
    "overlapping": (WINDOWS[:2], 5.0, 2e-6, 7.5, 0.01, MATCH.format("1 separate part", 7.5, 7.5)),
    "a third": (WINDOWS[:8], 5.0, 2e-6, 65.0, 0.01, MATCH.format("4 separate parts", 22.5, 65)),
}


@pytest.mark.parametrize("case", LIMITS)
def test_what_makes_a_drift_a_guess(case):
    *given, why = LIMITS[case]
    advice = "shake both sensors together at the start and at the end, or use --clocks shift (clocks='shift')"
    assert doubts_of_drift(*given) == ([f"the drift of the clocks is a guess: {why}; {advice}"] if why else [])


@pytest.mark.parametrize(
    ("drift", "unsure", "words"),
    [
        (-200.3e-6, 4.9e-6, " at its first sample, drift -200 ± 5 ppm"),
        (1234.56e-6, 1180e-6, " at its first sample, drift +1230 ± 1000 ppm"),
        (0.0, 0.2e-6, " at its first sample, drift +0 ± 0.2 ppm"),
        (900e-6, np.inf, " at its first sample, drift +900 ± unknown ppm"),
        (0.0, None, ""),
    ],
)
def test_a_drift_is_told_with_its_uncertainty(drift, unsure, words):
    found = ClockFit(0.0, 1.25, drift, unsure, 0.98765, ())
    told = f"clock of relative_to: shifted by +1.25 s{words} (correlation of the angular speeds 0.988)"
    assert found.words() == told


def test_a_guessed_drift_is_warned_of():
    t, fore, s, arm, *_ = recordings(30, (100, 100), -200e-6, 10.0, MOUNTED, shakes=1)
    with pytest.warns(UserWarning, match="at times that relative_to does not cover|drift") as caught:
        found = twist(fore, t, relative_to=arm, relative_time=s, clocks="drift")
    assert any(GUESS.fullmatch(str(one.message)) for one in caught)
    assert re.search(r"drift [+-]\d+\.?\d* ± \d+ ppm \(correlation", found.attrs["alignment"])


def test_windows_that_match_in_one_part_make_a_drift_a_guess():
    """Both sensors move for the first third alone; by noise the speeds of the rest do not match."""
    t = np.arange(0, 90, 0.01)
    arm = Rotation.from_rotvec(np.outer(bump(t, 15, 12) * np.sin(2 * t + 0.1 * t**2), [0.3, 0.2, 0.5]))
    fit = fitted_clock(noisy(arm, 1e-7, 1), t, noisy(arm, 1e-7, 2), t + 3, drift=True)
    assert fit.unsure < 30e-6
    assert fit.doubts == (
        "the drift of the clocks is a guess: the angular speeds match in 4 separate parts, within 33.7 s of 89.99 s; "
        "shake both sensors together at the start and at the end, or use --clocks shift (clocks='shift')",
    )


def test_speeds_that_do_not_change_align_no_clocks():
    t = np.arange(0, 20, 0.01)
    for steady in (Rotation.identity(t.size), Rotation.from_rotvec(np.outer(t, [0.1, 0.2, 0.3]))):
        for clocks in ("shift", "drift"):
            with pytest.raises(ValueError, match="clocks") as told:
                twist(steady, t, relative_to=steady, relative_time=t + 3, clocks=clocks)
            assert str(told.value) == (
                "the clocks cannot be aligned: a sensor rests or turns at one speed all the time; shake both together; "
                "--clocks shared (clocks='shared') uses their times unchanged"
            )


def test_other_times_on_one_clock_are_interpolated_to_order_four():
    errors = []
    for rate in (40, 80):
        t, fore, s, arm, expected, _ = recordings(20, (200, rate), 0.0, 0.3, MOUNTED)
        inside = (t >= s[0]) & (t <= 20)
        found = twist(Rotation.from_quat(fore.as_quat()[inside]), t[inside], relative_to=arm, relative_time=s)
        errors.append(abs(found.twist_angle.values - (expected[inside] - expected[inside][0])).max())
    assert errors[0] / errors[1] > 2**3
    assert errors[1] < 1e-4


def test_the_mounting_of_the_second_sensor_does_not_change_the_twist():
    t, fore, _, _, expected, _ = recordings(20, (200, 200), 0.0, 0.3, MOUNTED)
    for mounting in (Rotation.identity(), MOUNTED):
        found = twist(fore, t, relative_to=upper(t, 20) * mounting)
        assert found.twist_angle.values == pytest.approx(expected - expected[0], abs=1e-7)
        assert found.attrs["alignment"] == ""


def test_static_alignment_makes_up_for_mountings():
    """In the pose at rest forearm and upper arm hang along the vertical; the sensors are strapped on anyhow."""
    t = np.arange(0, 20, 1 / 200)
    move = bump(t, 11, 7.0)
    swing, psi = 0.8 * move * np.sin(1.1 * t), 0.7 * move * np.sin(1.7 * t)
    turned = Rotation.from_euler("YZ", np.stack([swing, psi], axis=1))  # along a great circle: its twist is ψ
    arm = Rotation.from_euler("XY", np.stack([0.5 * move * np.sin(0.9 * t), 0.3 * move], axis=1))
    fore = arm * turned * Rotation.from_rotvec([1.2, 0.3, -0.8])
    found = twist(fore, t, relative_to=arm * MOUNTED, align="static")
    assert found.twist_angle.values == pytest.approx(psi, abs=1e-7)
    told = re.search(
        r"static pose chosen, from (\S+) to (\S+) s, which moves by up to (\S+)°", found.attrs["alignment"]
    )
    assert (float(told[1]) < 3.1, float(told[3]) < 1e-5) == (True, True)
    given = twist(fore, t, relative_to=arm * MOUNTED, align="static", static=(0, 2))
    assert given.twist_angle.values == pytest.approx(psi, abs=1e-7)
    plain = twist(fore, t, relative_to=arm * MOUNTED).twist_angle.values
    assert abs(plain - psi).max() > 0.1
    alone = twist(turned * MOUNTED, t, align="static")
    assert alone.twist_angle.values == pytest.approx(psi, abs=1e-7)
    with pytest.warns(UserWarning, match=r"^the sensors are not at rest in the static pose; choose another one$"):
        twist(fore, t, relative_to=arm, align="static", static=(8, 12))
    restless = Rotation.from_rotvec(np.outer(np.sin(3 * t), [0.3, 0.2, 0.5]))
    remedy = re.escape("--static T0,T1 (static=) says where it is")
    with pytest.warns(UserWarning, match=f"^the sensors are not at rest in the static pose; {remedy}$"):
        twist(fore, t, relative_to=restless, align="static")


UNMATCHED = (
    r"^the clocks cannot be aligned: the angular speeds of the two recordings do not match \(correlation 0\.[0-6]\d at "
    r"best\); --shake T0,T1 \(shake=\) names the time in which both sensors were shaken together; --clocks shared "
    r"\(clocks='shared'\) uses their times unchanged, if both come from one clock$"
)


def test_recordings_that_do_not_match_are_refused():
    t = np.arange(0, 30, 0.02)
    rng = np.random.default_rng(0)
    one, other = (
        Rotation.from_rotvec(np.cumsum(rng.normal(size=(t.size, 3)), axis=0) * 0.01 + rng.normal(size=3)) for _ in "ab"
    )
    with pytest.raises(ValueError, match=UNMATCHED):
        twist(one, t, relative_to=other, relative_time=t + 3, clocks="shift")


LATE, SHAKES = 4.321, [(1.0, 4.0), (46.0, 49.0)]  # s, of 50 s


def shaken(seed, drift=0.0, together=True, sigma=3e-4):
    """Times and attitudes of two sensors on an elbow, shaken in SHAKES at its rest, and the twist between them.

    It turns by up to 110°/s or more about its axis while the upper arm is nearly still. The second clock is LATE at its
    first sample.
    """
    f = np.random.default_rng(seed).uniform(0.8, 1.3, 12)

    def arm(t, tempi):
        hand = [
            bump(t, 2.5 + 45 * k, 1.5) * np.sin(15 * a * t + 1.5 * np.sin(4 * b * t))
            for k, (a, b) in enumerate(tempi.reshape(2, 2))
        ]
        slow = 0.05 * bump(t, 25, 19) * np.sin(2 * f[1] * t)
        return Rotation.from_euler("YX", np.stack([0.35 * sum(hand), slow], axis=1))

    t, true = np.arange(0, 50, 0.01), np.arange(0.4, 51, 1 / 61.7)
    move = bump(t, 25, 19)
    psi = move * (0.7 * np.sin(2.1 * f[0] * t) + 0.5 * np.sin(4.2 * f[2] * t))
    bent = 0.8 * move * (1 + np.sin(1.7 * f[3] * t))
    fore = arm(t, f[4:8] if together else f[8:]) * Rotation.from_euler("YZ", np.stack([bent, psi], axis=1))
    s = true[0] + LATE + (true - true[0]) / (1 + drift)
    return t, noisy(fore, sigma, seed), s, noisy(arm(true, f[4:8]) * MOUNTED, sigma, seed + 1), psi


def test_shifts_are_stated_to_10_us_however_large():
    t, fore, s, arm, _ = shaken(1)
    t += 1.7e9
    with pytest.warns(UserWarning, match="^dropped 40 rows at times that relative_to does not cover$"):
        found = twist(fore, t, relative_to=arm, relative_time=s, clocks="shift", shake=(1.7e9 + 1, 1.7e9 + 4))
    words = r"shifted by \+(16999999\d\d\.\d+) s \(correlation of the angular speeds from 1700000001 to 1700000004 s: "
    assert float(re.search(words, found.attrs["alignment"])[1]) == pytest.approx(1.7e9 - LATE, abs=2e-4)


def test_a_gap_that_leaves_few_steps_in_a_shake_is_refused():
    t, fore, s, arm, _ = shaken(1)
    t, s = t + 1e6 * (t > 25), s + 1e6 * (s > 25 + LATE)
    message = (
        "the clocks cannot be aligned: the recordings last so long, 1.00005e+06 s and 1.00005e+06 s, that they are "
        "compared in steps of 0.5 s, with 6 of them in --shake (shake=); cut off what lies far from it"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        twist(fore, t, relative_to=arm, relative_time=s, clocks="shift", shake=(1, 4))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("clocks", "drift"), [("shift", 0.0), (None, 0.0), ("drift", -300e-6)])
def test_clocks_are_aligned_by_the_part_in_which_both_are_shaken(clocks, drift, seed):
    """The motion of the joint alone is refused, or gives a drift that is off by more than all of it."""
    t, fore, s, arm, psi = shaken(seed, drift)
    given = {"relative_to": arm, "relative_time": s, "clocks": clocks}
    assert np.degrees(abs(np.gradient(psi, t)).max()) > 110
    with pytest.raises(ValueError, match=UNMATCHED):
        twist(fore, t, **given)
    shake = SHAKES if clocks == "drift" else SHAKES[0]
    with pytest.warns(UserWarning, match="at times that relative_to does not cover") as caught:
        found = twist(fore, t, **given, shake=shake)
    assert len(caught) == 1
    told = re.fullmatch(
        r"clock of relative_to: shifted by (\S+) s(?: at its first sample, drift (\S+) ± (\S+) ppm)? \(correlation of "
        r"the angular speeds from 1 to 4 s( and 46 to 49 s)?: (\S+)\)",
        found.attrs["alignment"],
    )
    assert float(told[1]) == pytest.approx(-LATE, abs=2e-4)
    if clocks == "drift":
        assert abs(float(told[2]) - 1e6 * drift) < 1.5 * float(told[3]) < 15
    assert bool(told[4]) == (clocks == "drift")
    assert float(told[5]) > 0.99
    at = np.searchsorted(t, found.time.values)
    error = found.twist_angle.values - psi[at]
    assert np.degrees(abs(error - error[0]).max()) < 0.2  # of noise: 0.02° in each attitude


@pytest.mark.parametrize("clocks", ["shift", "drift"])
def test_no_shift_is_made_up_of_a_part_in_which_the_sensors_move_on_their_own(clocks):
    """Refused, or warned of: shaken one by one, or named where the joint moves."""
    refused = 0
    for seed in range(25):
        for together, first in ((True, 20.0), (False, 1.0), (False, 24.0)):
            t, fore, s, arm, _ = shaken(seed, together=together)
            shake = np.array([[first, first + 3.0], [first + 10, first + 13]])[: 1 + (clocks == "drift")]
            try:
                fit = fitted_clock(fore, t, arm, s, drift=clocks == "drift", shake=shake)
            except ValueError:
                refused += 1
                continue
            assert abs(fit.shift + LATE) < 0.05 or fit.correlation < SURE or fit.doubts
    assert refused > 60
    t, fore, s, arm, _ = shaken(1)
    with pytest.raises(ValueError, match="clocks") as told:
        fitted_clock(fore, t, arm, s, drift=clocks == "drift", shake=np.array([[20.0, 23.0]]))
    assert re.fullmatch(
        r"the clocks cannot be aligned: the angular speeds in --shake \(shake=\) match with a correlation of 0\.\d+ at "
        r"best, 0\.9 is required; name times of the first recording in which both sensors were shaken together, hard, "
        r"with the joint at rest",
        str(told.value),
    )


SHAKE_REFUSED = {
    "one clock": (
        {"clocks": "shared"},
        "--shake (shake=) aligns two clocks: add --clocks shift (clocks='shift') or --clocks drift (clocks='drift')",
    ),
    "one sensor": (
        {"relative_to": None, "relative_time": None},
        "--shake (shake=) is of two sensors: name the second, --relative-to FILE (relative_to=)",
    ),
    "short": (
        {"shake": (2, 2.2)},
        "clocks are aligned from at least 50 samples; there are 21 in --shake (shake=), which is in the times of the "
        "first recording, 0 s to 49.99 s, and 3123 in the second",
    ),
    "rest": (
        {"shake": (-5, 0.9)},
        "the clocks cannot be aligned: a sensor rests or turns at one speed all the time of --shake (shake=); shake "
        "both together; --clocks shared (clocks='shared') uses their times unchanged",
    ),
    "order": ({"shake": (4, 1)}, "shake must be pairs of times, the earlier first, got [[4.0, 1.0]]"),
    "none": ({"shake": np.empty((0, 2))}, "shake must be pairs of times, the earlier first, got []"),
    "three": ({"shake": (1, 2, 3)}, "shake must have the shape (n, 2), got (3,)"),
}


@pytest.mark.parametrize("case", SHAKE_REFUSED)
def test_a_shake_is_refused(case):
    options, message = SHAKE_REFUSED[case]
    t, fore, s, arm, _ = shaken(0, sigma=0)
    with pytest.raises(ValueError, match="shake") as told:
        twist(fore, t, **{"relative_to": arm, "relative_time": s, "clocks": "shift", "shake": (1, 4), **options})
    assert str(told.value) == message


def test_a_shake_that_matches_loosely_is_warned_of():
    t, fore, s, arm, _ = shaken(0)
    with pytest.warns(UserWarning, match="clocks are aligned|does not cover") as caught:
        found = twist(noisy(fore, 8e-3, 5), t, relative_to=arm, relative_time=s, clocks="shift", shake=(1, 4))
    told = re.search(r"correlation .* (0\.9[0-6]\d)\)", found.attrs["alignment"])
    assert str(caught[0].message) == (
        f"the clocks are aligned by angular speeds that match with a correlation of {float(told[1]):.2f} alone: "
        "sensors that are shaken together, hard, reach 0.97; check the times of --shake (shake=)"
    )


def test_a_motion_that_repeats_is_said():
    t = np.arange(0, 60, 0.02)
    arm = Rotation.from_rotvec(np.outer(np.sin(2 * t) + 0.1 * np.sin(t), [0.3, 0.2, 0.5]))
    with pytest.warns(UserWarning, match=r"another shift of the clocks, .* fits nearly as well .*: the motion repeats"):
        twist(arm, t, relative_to=arm, relative_time=t, clocks="shift")


REFUSED = {
    "no overlap": (
        {"relative_time": np.arange(100) / 50 + 10},
        "the recordings do not overlap: one is from 0 s to 1.98 s",
    ),
    "few samples": (
        {"rows": 20, "clocks": "shift"},
        "clocks are aligned from at least 50 samples; there are 20 and 100",
    ),
    "no times": ({"clocks": "shift"}, "clocks are aligned from times; give those of both recordings: --rate"),
    "clocks": ({"clocks": "both"}, "clocks must be 'shared', 'shift' or 'drift', got 'both'"),
    "align": ({"align": "moving"}, "align must be None or 'static', got 'moving'"),
    "static": ({"align": "static", "static": (2, 1)}, "static must be two times, the earlier first, got [2.0, 1.0]"),
    "no pose": ({"align": "static", "static": (7, 8)}, "no sample is between 7 and 8; they are from 0 to 1.98"),
    "rows": ({"rows": 20, "time": None}, "relative_to has 100 samples, the motion 20: without times of both"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    options, message = REFUSED[case]
    t = np.arange(100) / 50
    motion = Rotation.from_rotvec(np.outer(np.sin(t), [0.1, 0.2, 0.3]))
    given = {"time": t, "relative_to": motion, **options}
    rows = given.pop("rows", 100)
    given["time"] = None if given["time"] is None else given["time"][:rows]
    if case in ("few samples",):
        given["relative_time"] = t
    with pytest.raises(ValueError, match=re.escape(message)):
        twist(motion[:rows], **given)


# the command


@pytest.mark.parametrize("dated", [False, True])
def test_the_command_aligns_clocks_by_shakes(tmp_path, dated):
    t, fore, s, arm, _ = shaken(1, -300e-6)
    if dated:
        start = pandas.Timestamp("2026-03-01T12:00:00")
        t, s = ([(start + pandas.Timedelta(x, unit="s")).isoformat() for x in time] for time in (t, s))
    one = written(tmp_path / "fore.csv", "qw qx qy qz", fore, t)
    other = written(tmp_path / "upper.csv", "qw qx qy qz", arm, s)
    run = ("--relative-to", other, "--json", "--force", "--out", str(tmp_path / "o"))
    told = json.loads(command(one, *run, "--shake", "1,4").stdout)["alignment"]
    if dated:
        assert told.startswith(
            "clock of relative_to: that of the dates of both files, by which it begins 4.721 s after"
        )
        assert re.search(r"\(correlation of the angular speeds from 1 to 4 s: -?0\.\d+\)$", told)
    else:
        assert told.startswith("clock of relative_to: shifted by -4.32")
    told = json.loads(command(one, *run, "--shake", "1,4", "--shake", "46,49", "--clocks", "drift").stdout)["alignment"]
    shift, drift = re.search(r"shifted by (\S+) s at its first sample, drift (\S+) ± \S+ ppm \(", told).groups()
    assert float(shift) == pytest.approx(-LATE, abs=2e-4)
    assert float(drift) == pytest.approx(-300, abs=15)


def test_the_command_refuses_shakes(tmp_path):
    file = written(tmp_path / "one.csv", "qw qx qy qz", Rotation.from_rotvec(np.eye(3)), np.arange(3))
    for arguments, message in (
        (("--shake", "1,2"), "there is no second sensor: --relative-to FILE"),
        (("--relative-to", file, "--shake", "1"), "'1' is not two times like 0,2.5"),
    ):
        result = command(file, *arguments, "--out", str(tmp_path / "o"))
        assert (result.exit_code, f"Invalid value for --shake: {message}" in result.stderr) == (2, True)


def written(path, names, rotation, time=None, **more):
    columns = dict(zip(names.split(), np.roll(rotation.as_quat(), 1, axis=1).T, strict=True))
    times = {} if time is None else {"time": time}
    pandas.DataFrame({**times, **columns, **more}).to_csv(path, index=False)
    return str(path)


def command(*arguments):
    return CliRunner().invoke(app, ["twist", *arguments, "--no-figure"], env={"COLUMNS": "200"})


def test_the_command_with_two_files(tmp_path):
    t, fore, s, arm, expected, shift = recordings(60, (100, 61.7), 0.0, 10.0, MOUNTED)
    one = written(tmp_path / "fore.csv", "qw qx qy qz", fore, t)
    other = written(tmp_path / "upper.csv", "qw qx qy qz", arm, s)
    out = str(tmp_path / "o")
    result = command(one, "--relative-to", other, "--json", "--out", out)
    assert result.exit_code == 0, result.stderr
    facts = json.loads(result.stdout)
    told = re.search(r"shifted by (\S+) s \(correlation of the angular speeds (\S+)\)", facts["alignment"])
    assert float(told[1]) == pytest.approx(shift, abs=1e-3)
    assert float(told[2]) > 0.95
    assert facts["relative_to"].startswith(f"{other}: orientation: quaternion qw, qx, qy, qz; time: column 'time'")
    found = open_run(f"{out}.nc")
    at = np.searchsorted(t, found.time.values)
    assert found.twist_angle.values == pytest.approx(expected[at] - expected[at[0]], abs=np.radians(0.02))
    shown = command(one, "--relative-to", other, "--out", str(tmp_path / "p")).stdout
    assert "alignment" in shown
    assert "clock of the second recording: shifted by" in shown
    again = command(one, "--relative-to", other, "--out", out)
    assert (again.exit_code, "exists; choose another name" in again.stderr) == (5, True)


def moving_joint(tmp_path, first, late=0.0):
    """Two files with the same times from `first` on, of a joint that moves as much as the arm; one is `late`."""
    t = np.arange(0, 6, 0.01)
    angles = [[20, 15, 30] * np.sin(np.outer(s, [1, 1.3, 0.7])) for s in (t, t + late)]
    arm, later = (Rotation.from_euler("ZYX", one, degrees=True) for one in angles)
    moved = np.column_stack([40 + 30 * np.sin(2 * t), 5 * np.sin(t), 50 * np.sin(1.1 * t)])
    fore = arm if late else arm * Rotation.from_euler("XYZ", moved, degrees=True)
    one = written(tmp_path / "fore.csv", "qw qx qy qz", fore, first + t)
    return one, written(tmp_path / "upper.csv", "qw qx qy qz", later, first + t)


def test_equal_times_are_of_one_clock(tmp_path):
    """From zero on, of two only where the speeds tell: a shift of 0.13 s matches the motion of this joint best."""
    out = ("--out", str(tmp_path / "o"), "--force")
    one, two = moving_joint(tmp_path, 0.0)
    asked = command(one, "--relative-to", two, *out)
    assert asked.exit_code == 3
    assert "angular speeds match best 0.13 s apart (correlation 0.70), which may be the motion of the" in asked.stderr
    shared = command(one, "--relative-to", two, "--clocks", "shared", *out)
    shifted = command(one, "--relative-to", two, "--clocks", "shift", *out)
    assert "match with a correlation of 0.70 alone: the joint moves as well" in shifted.stderr
    assert "alignment" not in shared.stdout
    same = command(*moving_joint(tmp_path, 1234.5)[:1], "--relative-to", two, *out)
    assert "alignment" not in same.stdout
    assert same.exit_code == shared.exit_code == 0
    told = command(*moving_joint(tmp_path, 0.0, 0.5)[:1], "--relative-to", two, *out)
    assert "shifted by +0.5 s (correlation of the angular speeds 1.000)" in told.stdout


def test_the_command_with_two_sensors_in_one_file(tmp_path):
    t, fore, _, _, expected, _ = recordings(20, (100, 100), 0.0, 0.3, MOUNTED)
    arm = np.roll((upper(t, 20) * MOUNTED).as_quat(), 1, axis=1)
    names = ("u_qw", "u_qx", "u_qy", "u_qz")
    path = written(tmp_path / "both.csv", "f_qw f_qx f_qy f_qz", fore, t, **dict(zip(names, arm.T, strict=True)))
    by_columns = ["--columns", "time,f_qw,f_qx,f_qy,f_qz", "--scalar-first", "--relative-columns", ",".join(names)]
    for options in (by_columns, ["--body", "f", "--relative-body", "u"]):
        result = command(path, *options, "--out", str(tmp_path / "o"), "--force", "--quiet")
        assert (result.exit_code, result.stderr) == (0, "")
        found = open_run(tmp_path / "o.nc").twist_angle.values
        assert found == pytest.approx(expected - expected[0], abs=1e-5)


def test_euler_angles_of_two_sensors_in_one_file_are_named_by_their_bodies(tmp_path):
    t = np.arange(0, 5, 0.01)
    arm = Rotation.from_euler("ZYX", np.stack([0.3 * np.sin(t), 0.5 * np.cos(2 * t), 0.2 * t], axis=1))
    fore = arm * Rotation.from_euler("z", 0.7 * np.sin(t)[:, None])
    table = {"time": t}
    for name, motion in (("fore", fore), ("upper", arm)):
        angles = motion.as_euler("XYZ", degrees=True)
        table |= {f"{name}_Euler_{axis}": one for axis, one in zip("XYZ", angles.T, strict=True)}
    pandas.DataFrame(table).to_csv(tmp_path / "both.csv", index=False)
    options = ["--euler", "XYZ", "--angle-unit", "deg", "--body", "fore", "--relative-body", "upper"]
    result = command(str(tmp_path / "both.csv"), *options, "--out", str(tmp_path / "o"), "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["twist_angle"] == pytest.approx(0.7 * np.sin(t[-1]), abs=1e-9)


def test_dates_put_two_files_on_one_clock(tmp_path):
    t, fore, _, _, expected, _ = recordings(20, (100, 100), 0.0, 0.3, MOUNTED)
    late = 3.0
    true = np.arange(late, 22, 0.01)
    start = pandas.Timestamp("2026-03-01T12:00:00")
    dates = [[(start + pandas.Timedelta(x, unit="s")).isoformat() for x in time] for time in (t, true)]
    one = written(tmp_path / "a.csv", "qw qx qy qz", fore, dates[0])
    other = written(tmp_path / "b.csv", "qw qx qy qz", upper(true, 20), dates[1])
    with pytest.warns(UserWarning, match="^dropped 300 rows at times that relative_to does not cover$"):
        found = twist(read_motion(one), relative_to=read_motion(other))
    inside = t >= late - 1e-9
    assert found.twist_angle.values == pytest.approx((expected - expected[inside][0])[inside], abs=1e-6)


@pytest.mark.parametrize("ahead", [0.0, 2.5, -3600.0])
def test_dates_are_the_clock_of_two_files_by_default(ahead, tmp_path):
    """Where they overlap; if the speeds contradict them, this is said; where they do not, the speeds tell."""
    t, fore, _, _, expected, _ = recordings(20, (100, 100), 0.0, 0.3, MOUNTED)
    true = np.arange(1.0, 22.0, 0.01)
    start = pandas.Timestamp("2026-03-01T12:00:00")
    dates = [[(start + pandas.Timedelta(x, unit="s")).isoformat() for x in time] for time in (t, true + ahead)]
    one = written(tmp_path / "a.csv", "qw qx qy qz", fore, dates[0])
    other = written(tmp_path / "b.csv", "qw qx qy qz", upper(true, 20), dates[1])
    run = command(one, "--relative-to", other, "--out", str(tmp_path / "o"), "--json")
    assert run.exit_code == 0, run.stderr
    found = open_run(tmp_path / "o.nc")
    shift = re.search(r"shifted by (\S+) s", run.stderr.replace("\n", " ") + found.attrs["alignment"])
    if ahead > 0:
        assert (
            "the dates are used, but the angular speeds match best with the second recording shifted by" in run.stderr
        )
    if ahead >= 0:
        assert found.attrs["alignment"].startswith(
            f"clock of relative_to: that of the dates of both files, by which it begins {1 + ahead:.4g} s after the "
            "other (correlation of the angular speeds "
        )
    if ahead == 0:
        assert shift is None
        inside = (t >= true[0] - 1e-9) & (t <= true[-1] + 1e-9)
        assert found.twist_angle.values == pytest.approx((expected - expected[inside][0])[inside], abs=1e-6)
    else:
        assert shift is not None
        assert float(shift[1]) == pytest.approx(-ahead, abs=2e-3)


@pytest.mark.parametrize("late", [0.0, 0.06, 0.1, 0.35])
def test_dates_that_are_a_little_wrong_are_told(late, tmp_path):
    """Speeds that repeat match by wrong dates as well, but far better by others; by true dates nothing is said."""
    t = np.arange(0, 40, 0.01)
    swing = np.where((t > 2) & (t < 6), 0.8 * np.sin(9 * (t - 4)), 0.0) * bump(t, 4, 2.0)
    arm = Rotation.from_euler("ZY", np.stack([0.9 * bump(t, 23, 15) * np.sin(0.7 * t), swing], axis=1))
    fore = arm * Rotation.from_euler("Z", (0.5 * bump(t, 20, 10) * np.sin(1.1 * t))[:, None])
    start = pandas.Timestamp("2026-03-01T12:00:00")
    files = [
        written(
            tmp_path / name, "qw qx qy qz", motion, [(start + pandas.Timedelta(x, unit="s")).isoformat() for x in s]
        )
        for name, motion, s in (("fore.csv", fore, t), ("arm.csv", arm, t - late))
    ]
    run = command(files[0], "--relative-to", files[1], "--out", str(tmp_path / "o"))
    assert run.exit_code == 0, run.stderr
    told = [line for line in run.stderr.splitlines() if "the dates are used" in line]
    assert len(told) == (late > 0)
    if told:
        shift, best, alike = map(float, re.search(r"by (\S+) s \(correlation (\S+) against (\S+)\)", told[0]).groups())
        assert shift == pytest.approx(late, abs=2e-3)
        assert 0.05 < 1 - alike > 2 * (1 - best)


def test_speeds_that_do_not_change_have_no_correlation():
    t = np.arange(0, 2, 0.01)
    still, moving = Rotation.identity(t.size), Rotation.from_rotvec(np.outer(np.sin(5 * t), [1, 0, 0]))
    assert speed_correlation(moving, t, moving, t) == pytest.approx(1, abs=1e-12)
    for pair in ((still, moving), (moving, still), (still, still)):
        assert speed_correlation(pair[0], t, pair[1], t) == 0
    assert speed_correlation(moving, t, moving, t + 100) == 0


def test_the_second_file_has_options_of_its_own(tmp_path):
    t = np.arange(0, 20, 0.02)
    motion = Rotation.from_euler("ZYX", np.stack([np.sin(t), 0.5 * np.sin(2.3 * t), 0.3 * t], axis=1))
    one = written(tmp_path / "one.csv", "qw qx qy qz", motion, t)
    turned = motion * Rotation.from_rotvec([0.3, 0.2, 0.1])
    two = written(tmp_path / "two.csv", "q0 q1 q2 q3", turned.inv(), np.arange(t.size) * 20)
    pose = (str(tmp_path / "o"), "--json", "--force")
    result = command(one, "--relative-to", two, "--clocks", "shared", "--out", *pose)
    assert result.exit_code == 3
    assert "two.csv: the column 'time' does not state its unit" in result.stderr
    assert 'for this file alone: --relative-options "..."' in result.stderr
    own = ("--relative-options", "--inverse --scalar-first --time-unit ms")
    result = command(one, "--relative-to", two, *own, "--clocks", "shared", "--out", *pose)
    assert result.exit_code == 0, result.stderr
    facts = json.loads(result.stdout)
    assert abs(facts["twist_angle"]) < 1e-12
    assert "inverted" not in facts["read"]
    assert "scalar first (as given)" in facts["relative_to"]
    assert "inverted" in facts["relative_to"]
    swapped = command(
        two, *own[1].split(), "--relative-to", one, "--relative-options", "", "--clocks", "shared", "--out", *pose
    )
    assert abs(json.loads(swapped.stdout)["twist_angle"]) < 1e-12


WRONG_OPTIONS = {
    "no file": (("--relative-options", "--inverse"), "there is no second file: --relative-to FILE"),
    "of the first": (("--relative-to", "{}", "--relative-options", "--axis x"), "--axis is not one of --time-column"),
    "body": (("--relative-to", "{}", "--relative-options", "--body a"), "--body is not one of"),
    "columns": (("--relative-to", "{}", "--relative-options", "--columns a"), "--columns is not one of"),
    "help": (("--relative-to", "{}", "--relative-options", "-h"), "nontwist twist -h lists them"),
    "quotes": (("--relative-to", "{}", "--relative-options", "it's"), "has a quotation mark too few"),
    "unknown": (("--relative-to", "{}", "--relative-options", "--inverted"), "No such option"),
}


@pytest.mark.parametrize("case", WRONG_OPTIONS)
def test_wrong_options_of_the_second_file(case, tmp_path):
    arguments, message = WRONG_OPTIONS[case]
    file = written(tmp_path / "one.csv", "qw qx qy qz", Rotation.from_rotvec(np.eye(3)), np.arange(3))
    result = command(file, *[one.format(file) for one in arguments], "--out", str(tmp_path / "o"))
    assert result.exit_code == 2
    assert message in result.stderr


def test_messages_about_the_second_file_name_its_options(tmp_path):
    t = np.arange(5) / 10
    still = Rotation.identity(5)
    one = written(tmp_path / "one.csv", "qw qx qy qz", still, t)
    two = written(tmp_path / "two.csv", "a_qw a_qx a_qy a_qz", still, t, b_qw=1.0, b_qx=0.0, b_qy=0.0, b_qz=0.0)
    out = ("--out", str(tmp_path / "o"))
    result = command(one, "--relative-to", two, *out)
    assert "--relative-body takes one of a, b; or name the columns to take: --relative-columns" in result.stderr
    single = written(tmp_path / "single.csv", "qw qx qy qz", still[:1], t[:1])
    result = command(one, "--relative-to", single, *out)
    assert "the second recording: a twist needs at least 2 samples; 1 of 1 are left" in result.stderr


def test_headers_that_tell_the_scalar_tell_it_where_they_are_named():
    values = Rotation.from_rotvec(np.outer(np.linspace(0.5, 1, 9), [1, 2, 3])).as_quat()
    table = pandas.DataFrame(values, columns=["qx", "qy", "qz", "qw"])
    for names in (["qx", "qy", "qz", "qw"], ["qw", "qx", "qy", "qz"]):
        found = read_motion(io.StringIO(table.to_csv(index=False)), names)
        assert np.allclose(found, values, atol=1e-15)


def test_nothing_is_made_up_in_gaps_of_the_second_sensor():
    t, fore, s, arm, expected, _ = recordings(60, (100, 61.7), 0.0, 10.0, MOUNTED)
    kept = (s < s[0] + 20) | (s > s[0] + 25)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = twist(fore, t, relative_to=arm[kept], relative_time=s[kept], clocks="shift")
    told = [str(one.message) for one in caught]
    assert told[0].startswith("relative_to: 1 gap longer than 5 sampling intervals, the longest of 5.0")
    assert told[1] == "dropped 532 rows at times that relative_to does not cover"
    inside = (found.time > 20.4) & (found.time < 25.2)
    assert not inside.any()
    early = found.twist_angle.sel(time=slice(None, 20))
    at = np.searchsorted(t, early.time)
    assert early.values == pytest.approx(expected[at] - expected[at[0]], abs=np.radians(0.01))
