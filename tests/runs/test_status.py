"""Status 0 means: t_end reached, times increasing, all numbers finite; a continued run keeps its grid."""

import re

import numpy as np
import pytest

import nontwist as nt
from conftest import BODIES
from nontwist import integrate, moment, nontwisting, simulate, simulate_ensemble, sine
from nontwist.errors import SimulationError, Status
from nontwist.integrators import INTEGRATORS, LieMidpoint
from nontwist.integrators.ivp import IVP
from nontwist.models.stack import stacked
from refusals import says

BODY, W = nt.standard([3, 4, 5]), {"material_angular_velocity": (1, 2, 3)}
LOAD = sine([3, -1, 2], 1) + sine([0.5, 0, 1], 2, frame="space")
ODD = [(0.7, 187), (0.9169341449510143, 5), (0.013276945193271291, 100), (1.1, 49)]  # (T, N)


def grid(t_start, t_end, N):
    return IVP(stacked(BODY), np.eye(4)[3:], np.zeros((1, 3)), nt.Load(), t_start, t_end, N, np.arange(N + 1))


def test_grids_begin_and_end_exactly():
    rng = np.random.default_rng(17)
    ends, counts, missed = rng.uniform(0, 1, 800) * 10.0 ** rng.integers(-3, 3, 800), rng.integers(1, 200, 800), 0
    for t_end, N in zip(ends, counts, strict=True):
        t_start = 0.0 if rng.random() < 0.7 else float(rng.normal())
        t_end += t_start
        times, plain = grid(t_start, t_end, N).stored_times, t_start + (t_end - t_start) * np.arange(N + 1) / N
        assert (times[0], times[-1]) == (t_start, t_end)
        assert (np.diff(times) > 0).all()
        assert np.array_equal(times[:-1], plain[:-1])
        missed += plain[-1] != times[-1]
    assert missed > 12  # the plain formula misses t_end in 2 to 11 % of such grids


@pytest.mark.parametrize("name", INTEGRATORS)
def test_every_integrator_reaches_t_end(name):
    for t_end, N in ODD[:2]:
        how = {"t_end": t_end, "step": t_end / N, "integrator": name, **W}
        for store, states in ((1, N + 1), ("end", 2)):
            run, many = integrate(BODY, store=store, **how), simulate_ensemble(BODY, store=store, **how)
            assert (run.status, len(run.directors), many.sizes["time"]) == (Status.OK, states, states)
            assert run.time[-1] == float(many.time[-1]) == t_end
            assert not many.status.any()
            assert np.isfinite(many.quaternion).all()


def test_steps_below_time_resolution():
    how = {"t_start": 1e9, "t_end": 1e9 + 1, **W}
    for call in (simulate, simulate_ensemble):
        with says() as told:
            call(BODY, step=1e-6, **how)
    enough = float(re.search(r"step = (\S+) s would do", str(told.value))[1])
    assert enough < 5e-6
    assert simulate(BODY, step=enough, store="end", **how).attrs["status"] == Status.OK


def spoiling(function):
    """An integrator whose results one function spoils."""

    class Spoilt(LieMidpoint):
        def march(self, problem, threads=1):
            return function(super().march(problem, threads))

    return Spoilt()


def spoilt(name, value, *at, member=0):
    def spoil(outcome):
        found = next(one for one in (outcome, outcome.states, outcome.intervals) if name in one._fields)
        getattr(found, name)[(member, *at)] = value
        return outcome

    return spoiling(spoil)


NOT_FINITE = "is not finite at the end of it; choose units of time, length and mass in which the numbers of the run "
NOT_FINITE += "are nearer to 1"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "value", "said", "store"),
    [
        ("quaternion", np.nan, "quaternion", 1),
        ("velocity", np.inf, "material_angular_velocity", 5),
        ("velocity", 1e160, "kinetic_energy", 1),
        ("multipliers", np.nan, "multipliers", 5),
        ("moment", -np.inf, "moment", 1),
        ("load_work", np.nan, "load_work", 1),
    ],
)
def test_infinite_result(name, value, said, store):
    good, how = 3 + (name not in ("quaternion", "velocity")), {"angular_velocity": [1, 2, 0], "store": store}
    with pytest.raises(SimulationError) as info:
        integrate(BODIES["nontwisting"](), t_end=2, step=0.1, integrator=spoilt(name, value, 3), **how)
    error, kept, step = info.value, info.value.partial, store * (good - 1)
    assert str(error) == f"step {step} at t = {step / 10:.12g} s: the variable {said} {NOT_FINITE}"
    assert (error.status, error.time) == (Status.NOT_FINITE, pytest.approx(step / 10))
    assert (kept.status, len(kept.directors), len(kept.moment)) == (Status.NOT_FINITE, good, good - 1)
    assert all(np.isfinite(variable).all() for variable in kept.to_dataset().data_vars.values())


def test_quaternion_off_unit_length():
    """Of many states that are rounded, by less than is refused of one and more of all together, it is none."""
    said = "step 2 at t = 0.2 s: its quaternion is not of unit length, which is a defect of the integrator; "
    for length in (0.0, 0.9, 1.001):
        with pytest.raises(SimulationError, match=f"^{re.escape(said)}use another integrator$") as info:
            integrate(BODY, t_end=2, step=0.1, integrator=spoilt("quaternion", (0, 0, 0, length), 3), **W)
        assert (info.value.status, len(info.value.partial.directors)) == (Status.NOT_FINITE, 3)

    def rounded(outcome):
        outcome.states.quaternion[:] *= 1 + 1e-4
        return outcome

    many = simulate_ensemble(BODY, t_end=2, step=0.1, store=1, integrator=spoiling(rounded), reduce="extrema", **W)
    assert many.status.values.tolist() == [0]
    assert np.isfinite(many.kinetic_energy_max).all()


def test_missing_states():
    scheme = spoiling(lambda outcome: outcome._replace(good=np.array([8])))
    said = "the integrator returned 8 of 11 states, which is a defect of it; use another integrator"
    with pytest.raises(SimulationError, match=f"^step 7 at t = 0.7 s: {re.escape(said)}$") as info:
        integrate(BODY, t_end=1, step=0.1, integrator=scheme, **W)
    assert info.value.status == info.value.partial.status == Status.INCOMPLETE


def test_times_not_increasing(monkeypatch):
    sound = IVP._at
    monkeypatch.setattr(IVP, "_at", lambda self, *at: np.minimum(sound(self, *at), 0.55))
    with pytest.raises(SimulationError, match=r"^step 0 at t = 0 s: the output times do not increase up to t_end$"):
        integrate(BODY, t_end=1, step=0.1, integrator="exact", **W)
    with pytest.warns(UserWarning, match="2 of 2 members have failed, the first is 0: step 0 at t = 0 s: the output"):
        many = simulate_ensemble(BODY, t_end=1, step=0.1, store=1, integrator="exact", load_scale=[1, 1], **W)
    assert many.status.values.tolist() == [Status.INCOMPLETE] * 2


@pytest.mark.parametrize(
    ("what", "at", "value", "said"),
    [
        ("quaternion", (2,), np.nan, "quaternion"),
        ("velocity", (3, 0), np.inf, "material_angular_velocity"),
        ("velocity", (3,), 1e170, "kinetic_energy"),
        ("observed", (1, 0), np.inf, "kinetic_energy"),
    ],
)
def test_infinite_member(what, at, value, said):
    good, how = at[0], {"t_end": 1, "step": 0.1, "store": 2, "load_scale": [1, 1, 1], "reduce": "extrema", **W}
    sound = simulate_ensemble(BODY, integrator="lie-midpoint", **how)
    told = f"step {2 * (good - 1)} at t = {(good - 1) / 5:.12g} s: the variable {said} {NOT_FINITE}"
    with pytest.warns(UserWarning, match=f"^1 of 3 members have failed, the first is 1: {re.escape(told)}$"):
        many = simulate_ensemble(BODY, integrator=spoilt(what, value, *at, member=1), **how)
    assert many.status.values.tolist() == [0, Status.NOT_FINITE, 0]
    assert many.status.attrs["flag_meanings"].split()[-4:] == ["not_finite", "incomplete", "jump", "too_many"]
    assert many.message.values.tolist() == ["", told, ""]
    for name in ("quaternion", "material_angular_velocity", "kinetic_energy_max"):
        assert np.array_equal(many[name][[0, 2]], sound[name][[0, 2]])
        assert np.isnan(many[name][1, good:] if name != "kinetic_energy_max" else many[name][1]).all()
    assert np.isfinite(many.quaternion[1, :good]).all()


def test_too_short_run():
    """Its multipliers were once infinite: 2/h is no number."""
    with says():
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


@pytest.mark.parametrize(("name", "body"), [("lie-midpoint", "nontwisting"), ("energy-momentum", "standard")])
def test_run_in_two_parts(name, body, tmp_path):
    for T, N in (ODD[0], (0.37, 23)):
        system, how = BODIES[body](), {"step": T / N, "integrator": name, "load": LOAD}
        start = {"angular_velocity": (1.0, -2.0, 0.5), "project": True}
        whole, longer = (integrate(system, t_end=k * T, **start, **how) for k in (2, 4))
        first = integrate(system, t_end=T, **start, **how)
        second = integrate(system, t_end=2 * T, start=first, **how)
        assert (second.step, second.origin) == (first.step, 0.0)
        assert_same(bits(second), bits(whole, N))
        assert_same(bits(integrate(system, t_end=4 * T, start=second, **how)), bits(longer, 2 * N))
    for k, run in ((2, first), (4, second)):
        nt.save_run(run.to_dataset(), tmp_path / f"{k}.nc")
        again = integrate(system, t_end=k * T, start=nt.open_run(tmp_path / f"{k}.nc"), **how)
        assert_same(bits(again), bits(whole if k == 2 else longer, k * N // 2))


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_failed_run_is_continued():
    def sound(t, directors, w):
        return 0.0, t, 0.0

    def failing(t, directors, w):
        return 0.0, t if t < 0.5 else np.nan, 0.0

    how = {"t_end": 0.7, "step": 0.7 / 187, "integrator": "lie-midpoint"}
    whole = integrate(BODY, load=moment(sound), **W, **how)
    with pytest.raises(SimulationError) as info:
        integrate(BODY, load=moment(failing), **W, **how)
    rest = integrate(BODY, start=info.value.partial, load=moment(sound), **how)
    assert_same(bits(rest), bits(whole, len(info.value.partial.time) - 1))


def test_another_grid_is_not_continued():
    first = integrate(BODY, t_end=0.7, step=0.7 / 187, **W)
    for how in ({"t_end": 1.4, "step": 0.7 / 11}, {"t_end": 0.7 + 0.7 * (1 + 1e-10), "step": 0.7 / 187}):
        rest = integrate(BODY, start=first, **how)
        assert (rest.origin, rest.step) == (None, (how["t_end"] - 0.7) / (len(rest.time) - 1))
    assert integrate(BODY, start=first, t_start=1.0, t_end=1.7, step=0.7 / 187).origin is None


def test_ensemble_grid_is_continued():
    T, N = 0.7, 187
    how = {"step": T / N, "integrator": "lie-midpoint"}
    for first in (simulate_ensemble(BODY, t_end=T, **W, **how), simulate(BODY, t_end=T, **W, **how)):
        rest = simulate_ensemble(BODY, t_end=2 * T, start=first, store=1, load=LOAD, **how)
        assert (rest.attrs["step"], rest.attrs["origin"]) == (first.attrs["step"], 0.0)
        assert np.array_equal(rest.time[1:], grid(0.0, 2 * T, 2 * N).stored_times[N + 1 :])


def test_a_damaged_start_is_refused():
    body, key = nontwisting([3, 4, 5]), '{"euler_inertia": [[1,0,0],[0,1,0],[0,0,1]], "mass": 1}'
    damaged = [{"system": given} for given in ("null", "[1, 2]", key, "{", 5)]
    damaged += [{"memory": '{"a": 1}'}, {"memory": "["}, {"step": "x"}, {"origin": [1.0, 2.0]}]
    run = simulate(body, t_end=1, step=0.1, angular_velocity=(1, 2, 0))
    for attributes in damaged:
        with says():
            simulate(body, t_end=2, step=0.1, start=run.assign_attrs(attributes))


def breaking(t, directors, w):
    if t > 0.5:
        raise ArithmeticError
    return 0.0, 0.0, 0.0


@pytest.mark.parametrize("integrator", ["gauss", "lie-midpoint", "energy-momentum", "split", "continuous"])
def test_cause_in_a_load(integrator):
    how = {"material_angular_velocity": (1, 2, 0), "integrator": integrator, "load": moment(breaking)}
    with pytest.raises(SimulationError) as told:
        simulate(nontwisting([3, 4, 5]), t_end=1, step=None if integrator == "continuous" else 0.1, **how)
    assert isinstance(told.value.__cause__.__cause__, ArithmeticError)


def test_cause_in_a_stepper():
    beside = nt.memory_load(lambda t, z, d, w: -z, lambda t, z, d, w: 0 * w, [1.0])
    with pytest.raises(SimulationError) as told:
        nt.stepper(nontwisting([3, 4, 5]), step=2, load=moment(breaking) + beside, integrator="gauss").step()
    assert isinstance(told.value.__cause__.__cause__, ArithmeticError)
