"""Status 0 means: t_end reached, times increasing, all numbers finite; a continued run keeps its grid."""

import re
import warnings
from typing import ClassVar

import numpy as np
import pytest

from conftest import BODIES
from nontwist import (
    Load,
    integrate,
    memory_load,
    moment,
    nontwisting,
    open_run,
    save_run,
    simulate,
    simulate_ensemble,
    sine,
    standard,
    stepper,
)
from nontwist.errors import SimulationError, Status
from nontwist.integrators import INTEGRATORS, LieMidpoint, time_grid
from nontwist.integrators.problem import IVP
from nontwist.models.stack import stacked
from refusals import says

BODY, W = standard([3, 4, 5]), {"material_angular_velocity": (1, 2, 3)}
LOAD = sine([3, -1, 2], 1) + sine([0.5, 0, 1], 2, frame="space")
ODD = [(0.7, 187), (0.9169341449510143, 5), (0.013276945193271291, 100), (0.1, 3), (1.1, 49)]  # (T, N)


def grid(t_start, t_end, N):
    return IVP(stacked(BODY), np.eye(4)[3:], np.zeros((1, 3)), Load(), t_start, t_end, N, np.arange(N + 1))


def test_grids_begin_and_end_exactly():
    rng = np.random.default_rng(17)
    ends, counts, missed = rng.uniform(0, 1, 3192) * 10.0 ** rng.integers(-3, 3, 3192), rng.integers(1, 200, 3192), 0
    for t_end, N in zip(ends, counts, strict=True):
        t_start = 0.0 if rng.random() < 0.7 else float(rng.normal())
        t_end += t_start
        times, plain = grid(t_start, t_end, N).stored_times, t_start + (t_end - t_start) * np.arange(N + 1) / N
        assert times[0] == t_start
        assert times[-1] == t_end
        assert (np.diff(times) > 0).all()
        assert np.array_equal(times[:-1], plain[:-1])
        missed += plain[-1] != times[-1]
    assert missed > 50  # the plain formula misses t_end in 2 to 11 % of such grids


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize(("t_end", "N"), ODD)
def test_every_integrator_reaches_t_end(name, t_end, N):
    how = {"t_end": t_end, "step": t_end / N, "integrator": name, **W}
    for store, states in ((1, N + 1), ("end", 2)):
        run = integrate(BODY, store=store, **how)
        assert (run.status, len(run.directors)) == (Status.OK, states)
        assert run.time[-1] == t_end
        many = simulate_ensemble(BODY, store=store, **how)
        assert many.sizes["time"] == states
        assert float(many.time[-1]) == t_end
        assert not many.status.any()
        assert np.isfinite(many.quaternion).all()


def test_steps_below_the_resolution_of_the_times_are_refused():
    message = (
        "step = 1e-06 s is too short: times up to 1000000001 s are resolved to 1.2e-07 s; "
        "step = 3.81469726562e-06 s would do, or times counted from a start at 0"
    )
    how = {"t_start": 1e9, "t_end": 1e9 + 1, **W}
    for call in (simulate, simulate_ensemble):
        with pytest.raises(ValueError, match=re.escape(message)):
            call(BODY, step=1e-6, **how)
    assert simulate(BODY, step=3.81469726562e-06, store="end", **how).attrs["status"] == Status.OK


class Spoilt(LieMidpoint):
    """An integrator whose results one function spoils."""

    spoil: ClassVar = None

    def march(self, problem, threads=1):
        return type(self).spoil(super().march(problem, threads))


def spoilt(name, value, at):
    def spoil(outcome):
        found = next(one for one in (outcome.states, outcome.intervals) if name in one._fields)
        getattr(found, name)[0, at] = value
        return outcome

    return type("Spoilt", (Spoilt,), {"spoil": staticmethod(spoil)})()


OVERFLOWS = "; choose units of time, length and mass in which the numbers of the run are nearer to 1"


@pytest.mark.parametrize("store", [1, 5])
@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("quaternion", np.nan, "quaternion"),
        ("velocity", np.inf, "material_angular_velocity"),
        ("velocity", 1e160, "kinetic_energy"),
        ("multipliers", np.nan, "multipliers"),
        ("moment", -np.inf, "moment"),
        ("load_work", np.nan, "load_work"),
    ],
)
def test_a_result_that_is_not_finite_is_a_failed_run(name, value, said, store):
    body, at = BODIES["nontwisting"](), 3
    scheme = spoilt(name, value, at)
    good = at + (name not in ("quaternion", "velocity"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SimulationError) as info:
            integrate(body, t_end=2, step=0.1, store=store, angular_velocity=[1, 2, 0], integrator=scheme)
    error, step = info.value, store * (good - 1)
    begin = f"step {step} at t = {step / 10:.12g} s: the variable {said} is not finite at the end of it"
    assert (error.status, error.time) == (Status.NOT_FINITE, pytest.approx(step / 10))
    assert str(error) == begin + OVERFLOWS
    kept = error.partial
    assert (kept.status, len(kept.directors), len(kept.moment)) == (Status.NOT_FINITE, good, good - 1)
    assert all(np.isfinite(variable).all() for variable in kept.to_dataset().data_vars.values())


def test_a_quaternion_that_is_not_of_unit_length_is_a_failed_run():
    said = "step 2 at t = 0.2 s: its quaternion is not of unit length, which is a defect of the integrator; "
    for length in (0.0, 0.9, 1.001):
        with pytest.raises(SimulationError, match=f"^{re.escape(said)}use another integrator$") as info:
            integrate(BODY, t_end=2, step=0.1, integrator=spoilt("quaternion", (0, 0, 0, length), 3), **W)
        assert (info.value.status, len(info.value.partial.directors)) == (Status.NOT_FINITE, 3)


def test_rounded_quaternions_of_many_states_are_no_failure():
    class Rounded(LieMidpoint):
        def march(self, problem, threads=1):
            outcome = super().march(problem, threads)
            outcome.states.quaternion[:] *= 1 + 1e-4  # less than is refused of one, more of all together
            return outcome

    many = simulate_ensemble(BODY, t_end=2, step=0.1, store=1, integrator=Rounded(), reduce="extrema", **W)
    assert many.status.values.tolist() == [0]
    assert np.isfinite(many.kinetic_energy_max).all()


def test_states_that_are_missing_are_a_failed_run():
    def lose(outcome):
        return outcome._replace(good=np.array([8]))

    scheme = type("Spoilt", (Spoilt,), {"spoil": staticmethod(lose)})()
    said = "the integrator returned 8 of 11 states, which is a defect of it; use another integrator"
    with pytest.raises(SimulationError, match=f"^step 7 at t = 0.7 s: {re.escape(said)}$") as info:
        integrate(BODY, t_end=1, step=0.1, integrator=scheme, **W)
    assert info.value.status == info.value.partial.status == Status.INCOMPLETE


def test_times_that_do_not_increase_are_a_failed_run(monkeypatch):
    sound = time_grid.OnGrid._at
    monkeypatch.setattr(time_grid.OnGrid, "_at", lambda self, *at: np.minimum(sound(self, *at), 0.55))
    with pytest.raises(SimulationError, match=r"^step 0 at t = 0 s: the output times do not increase up to t_end$"):
        integrate(BODY, t_end=1, step=0.1, integrator="exact", **W)
    with pytest.warns(UserWarning, match="2 of 2 members have failed, the first is 0: step 0 at t = 0 s: the output"):
        many = simulate_ensemble(BODY, t_end=1, step=0.1, store=1, integrator="exact", load_scale=[1, 1], **W)
    assert many.status.values.tolist() == [Status.INCOMPLETE] * 2


class SpoiltMembers(LieMidpoint):
    """Spoils member 1 of ensembles."""

    def march(self, problem, threads=1):
        outcome = super().march(problem, threads)
        array = getattr(outcome if self.what == "observed" else outcome.states, self.what)
        array[(1, *self.at)] = self.value
        return outcome


@pytest.mark.parametrize(
    ("what", "at", "value", "good", "said"),
    [
        ("quaternion", (2,), np.nan, 2, "quaternion"),
        ("velocity", (3, 0), np.inf, 3, "material_angular_velocity"),
        ("velocity", (3,), 1e170, 3, "kinetic_energy"),
        ("observed", (1, 0), np.inf, 1, "kinetic_energy"),
    ],
)
def test_a_member_that_is_not_finite_has_failed_and_no_other(what, at, value, good, said):
    scheme = type("Scheme", (SpoiltMembers,), {"what": what, "at": at, "value": value})()
    how = {"t_end": 1, "step": 0.1, "store": 2, "load_scale": [1, 1, 1], "reduce": "extrema", **W}
    sound = simulate_ensemble(BODY, integrator="lie-midpoint", **how)
    begin = f"1 of 3 members have failed, the first is 1: step {2 * (good - 1)} at t = {(good - 1) / 5:.12g} s: "
    expected = begin + f"the variable {said} is not finite at the end of it" + OVERFLOWS
    with pytest.warns(UserWarning, match=f"^{re.escape(expected)}$"):
        many = simulate_ensemble(BODY, integrator=scheme, **how)
    assert many.status.values.tolist() == [0, Status.NOT_FINITE, 0]
    assert many.status.attrs["flag_meanings"].split()[-3:] == ["not_finite", "incomplete", "jump"]
    assert many.message.values.tolist() == ["", expected.partition("1: ")[2], ""]
    for name in ("quaternion", "material_angular_velocity", "kinetic_energy_max"):
        assert np.array_equal(many[name][[0, 2]], sound[name][[0, 2]])
    assert np.isfinite(many.quaternion[1, :good]).all()
    assert np.isnan(many.quaternion[1, good:]).all()
    assert np.isnan(many.material_angular_velocity[1, good:]).all()
    assert np.isnan(many.kinetic_energy_max[1])


def test_a_run_too_short_for_numbers_is_refused():
    """Its multipliers were once infinite: 2/h is no number."""
    with pytest.raises(ValueError, match=r"^step = 1e-313 s is not between 1e-140 and 1e\+140 s; choose another unit"):
        simulate(BODY, t_end=1e-311, integrator="energy-momentum", **W)
    short, long = (simulate(BODY, t_end=t, integrator="energy-momentum", **W) for t in (1e-130, 1e-6))
    assert short.multipliers.values[0] == pytest.approx(long.multipliers.values[0], rel=1e-4, abs=1e-4)


# Continued runs


def bits(run, first=0):
    """What a run has from the state of number `first` on; its time and velocity there come from another run."""
    after = run.time[first + 1 :], run.director_velocities[first + 1 :]
    return [*after, *(a[first:] for a in (run.directors, run.multipliers, run.moment, run.load_work))]


def assert_same(first, second):
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("name", ["lie-midpoint", "energy-momentum"])
@pytest.mark.parametrize("body", ["standard", "nontwisting"])
def test_a_run_to_T_and_on_to_2T_is_the_run_to_2T_bit_for_bit(name, body, tmp_path):
    rng = np.random.default_rng(3)
    pairs = [*ODD, *((float(rng.uniform(0.1, 1)), int(rng.integers(2, 60))) for _ in range(8))]
    for T, N in pairs:
        how = {"step": T / N, "integrator": name, "load": LOAD}
        start = {"angular_velocity": (1.0, -2.0, 0.5), "project": True}
        whole = integrate(BODIES[body](), t_end=2 * T, **start, **how)
        first = integrate(BODIES[body](), t_end=T, **start, **how)
        second = integrate(BODIES[body](), t_end=2 * T, start=first, **how)
        assert (second.step, second.origin) == (first.step, 0.0)
        assert_same(bits(second), bits(whole, N))
        fourth = integrate(BODIES[body](), t_end=4 * T, start=second, **how)
        assert_same(bits(fourth), bits(integrate(BODIES[body](), t_end=4 * T, **start, **how), 2 * N))
    save_run(first.to_dataset(), tmp_path / "first.nc")
    again = integrate(BODIES[body](), t_end=2 * T, start=open_run(tmp_path / "first.nc"), **how)
    assert_same(bits(again), bits(second))
    save_run(again.to_dataset(), tmp_path / "second.nc")
    again = integrate(BODIES[body](), t_end=4 * T, start=open_run(tmp_path / "second.nc"), **how)
    assert_same(bits(again), bits(fourth))


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_a_failed_run_is_continued_bit_for_bit():
    def sound(t, directors, w):
        return 0.0, t, 0.0

    def failing(t, directors, w):
        return 0.0, t if t < 0.5 else np.nan, 0.0

    for T, N in [(0.7, 187), (1.1, 49)]:
        how = {"t_end": T, "step": T / N, "integrator": "lie-midpoint"}
        whole = integrate(BODY, load=moment(sound), **W, **how)
        with pytest.raises(SimulationError) as info:
            integrate(BODY, load=moment(failing), **W, **how)
        rest = integrate(BODY, start=info.value.partial, load=moment(sound), **how)
        assert_same(bits(rest), bits(whole, len(info.value.partial.time) - 1))


def test_another_grid_is_not_continued():
    first = integrate(BODY, t_end=0.7, step=0.7 / 187, **W)
    for how in ({"t_end": 1.4, "step": 0.7 / 11}, {"t_end": 0.7 + 0.7 * (1 + 1e-10), "step": 0.7 / 187}):
        rest = integrate(BODY, start=first, **how)
        assert rest.origin is None
        assert rest.step == (how["t_end"] - 0.7) / (len(rest.time) - 1)
    later = integrate(BODY, start=first, t_start=1.0, t_end=1.7, step=0.7 / 187)
    assert later.origin is None


def test_an_ensemble_continues_the_grid_of_an_ensemble_and_of_a_run():
    T, N = 0.7, 187
    how = {"step": T / N, "integrator": "lie-midpoint"}
    for first in (simulate_ensemble(BODY, t_end=T, **W, **how), simulate(BODY, t_end=T, **W, **how)):
        rest = simulate_ensemble(BODY, t_end=2 * T, start=first, store=1, load=LOAD, **how)
        assert (rest.attrs["step"], rest.attrs["origin"]) == (first.attrs["step"], 0.0)
        assert np.array_equal(rest.time[1:], grid(0.0, 2 * T, 2 * N).stored_times[N + 1 :])


DAMAGED = {
    "system null": {"system": "null"},
    "system list": {"system": "[1, 2]"},
    "system key": {"system": '{"euler_inertia": [[1,0,0],[0,1,0],[0,0,1]], "mass": 1}'},
    "system text": {"system": "{"},
    "system number": {"system": 5},
    "memory": {"memory": '{"a": 1}'},
    "memory text": {"memory": "["},
    "step": {"step": "x"},
    "origin": {"origin": [1.0, 2.0]},
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_start_is_refused(case):
    attributes = DAMAGED[case]
    body = nontwisting([3, 4, 5])
    run = simulate(body, t_end=1, step=0.1, angular_velocity=(1, 2, 0)).assign_attrs(attributes)
    with says():
        simulate(body, t_end=2, step=0.1, start=run)


def breaking(t, directors, w):
    if t > 0.5:
        raise ArithmeticError
    return 0.0, 0.0, 0.0


@pytest.mark.parametrize("integrator", ["gauss", "lie-midpoint", "energy-momentum", "split", "continuous"])
def test_what_a_load_raised_is_the_cause(integrator):
    how = {"material_angular_velocity": (1, 2, 0), "integrator": integrator, "load": moment(breaking)}
    how |= {} if integrator == "continuous" else {"step": 0.1}
    for function in (simulate, integrate):
        with pytest.raises(SimulationError) as told:
            function(nontwisting([3, 4, 5]), t_end=1, **how)
        assert isinstance(told.value.__cause__.__cause__, ArithmeticError)


@pytest.mark.parametrize("beside", [Load(), memory_load(lambda t, z, d, w: -z, lambda t, z, d, w: 0 * w, [1.0])])
def test_what_a_load_of_a_stepper_raised_is_the_cause(beside):
    loop = stepper(nontwisting([3, 4, 5]), step=2, load=moment(breaking) + beside, integrator="gauss")
    with pytest.raises(SimulationError) as told:
        loop.step()
    assert isinstance(told.value.__cause__.__cause__, ArithmeticError)
