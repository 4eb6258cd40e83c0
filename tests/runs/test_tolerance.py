"""Runs to a tolerance: the error that comes out, against solutions by SciPy, and what is refused."""

import re
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import nontwist as nt
from conftest import compiled_load, or_long
from nontwist.driver import completion, tolerance
from nontwist.driver.starts import Starts
from nontwist.errors import SimulationError
from nontwist.integrators import Continuous, Gauss, Status
from nontwist.integrators.costs import gyration_rate, largest_velocity
from nontwist.models.stack import stacked
from refusals import refused_as, says
from tolerance_problems import Task, error_of, generated, truth

BODY = nt.standard([[3.1, 0.2, -0.3], [0.2, 4.2, 0.1], [-0.3, 0.1, 5.5]])
W = {"material_angular_velocity": (1.3, -0.7, 2.1)}
LOAD = nt.pulse((3, 1, 0.5), start=0.1234, end=0.777) + nt.sine((0.1, 0, 0.2), 0.7)
GAUSS = {"integrator": "gauss"}
SWITCH = 0.3456789  # on no grid of few steps


def ratios(seeds):
    """Return errors over tolerances of generated problems; those whose tolerance is refused are left out."""
    found = {}
    for seed in seeds:
        task = generated(seed)
        how = {"load": task.load, "tolerance": task.tolerance, **GAUSS, **task.start}
        try:
            run = nt.integrate(task.body, t_end=task.t_end, store="end" if task.store == "end" else 1, **how)
        except ValueError as error:
            least = r"cannot be reached: (the motion amplifies errors: )?a change of the start by two units of"
            if not re.search(least, str(error)):
                raise
            continue
        assert run.error_estimate <= run.tolerance == task.tolerance
        found[seed] = error_of(run, task) / task.tolerance
    return found


@pytest.mark.parametrize("goal", [1e-2, 1e-4])
def test_unconfirmed_error(goal, monkeypatch):
    """Above a tenth of the tolerance a third run confirms it, unless that would take more steps than any may."""
    how = {"t_end": 5, "material_angular_velocity": (0.1, 2, 0.3), "store": "end"}
    truth = nt.integrate(nt.standard([3, 4, 5]), tolerance=1e-11, **how).rotation[-1]
    how |= {"tolerance": goal, "integrator": "lie-midpoint"}
    confirmed = nt.integrate(nt.standard([3, 4, 5]), **how)
    monkeypatch.setattr(tolerance, "ENOUGH", confirmed.segments.steps // 2)
    with pytest.warns(UserWarning, match=rf"{goal:g}, would take too many$") as told:
        run = nt.integrate(nt.standard([3, 4, 5]), **how)
    assert int(re.search(r"the finer of (\d+) steps", str(told[0].message))[1]) == run.segments.steps
    assert len(told) == 1
    assert run.segments.steps < confirmed.segments.steps
    assert tolerance.TENTH * goal < run.error_estimate <= goal
    assert confirmed.error_estimate <= tolerance.TENTH * goal
    assert (run.rotation[-1].inv() * truth).magnitude() <= run.error_estimate


def test_run_failing_at_any_step(monkeypatch):
    sound = completion.checked_march

    def failing(*given):
        outcome = sound(*given)
        outcome.failures[:], outcome.good[:] = (Status.STALLED, 0, 1.0, 1.0), 1
        return outcome

    monkeypatch.setattr(tolerance.completion, "checked_march", failing)
    with pytest.raises(SimulationError, match="Newton's iteration stalled"):
        nt.simulate(BODY, t_end=1, tolerance=1e-6, **GAUSS, **W)


@pytest.mark.filterwarnings("ignore:a table of the load ends at", "ignore:the run will take about")
@pytest.mark.parametrize(("count", "share", "worst"), or_long([(4, 1, 1)], [(2000, 0.99, 10)]))
def test_generated_problems(count, share, worst):
    found = np.array(list(ratios(range(count)).values()))
    assert len(found) > count / 2
    assert np.mean(found <= 1) >= share
    assert found.max() <= worst


def test_choice_is_recorded():
    run = nt.integrate(BODY, t_end=5, load=LOAD, tolerance=1e-9, **GAUSS, **W)
    assert run.tolerance == 1e-9
    assert 0 <= run.error_estimate <= 1e-9
    assert run.integrator.order in (4, 8, 12, 16)
    assert run.step == pytest.approx(float(np.diff(run.time).max()), rel=1e-12)
    assert set(LOAD.breakpoints) <= set(run.time.tolist())
    assert nt.integrate(BODY, t_end=2, tolerance=1e-7, integrator=Gauss(order=6), **W).integrator == Gauss(order=6)
    assert nt.integrate(BODY, t_end=2, tolerance=1e-6, integrator="split", **W).integrator.order in (4, 6)
    old = nt.integrate(BODY, t_end=5, order=2, **GAUSS, **W)
    assert old.tolerance is None
    assert old.step * np.linalg.norm(old.material_angular_velocity, axis=1).max() <= 0.05


def test_states_are_close():
    """At most 0.05 rad and a hundredth of the run apart, however long the steps are; not where a tolerance is given."""
    shown = nt.integrate(BODY, t_end=5, **W)
    apart = np.diff(shown.time).max()
    assert 0.015 < apart * np.linalg.norm(shown.material_angular_velocity, axis=1).max() <= 0.05
    assert shown.step > 5 * apart
    assert (shown.tolerance, shown.error_estimate <= 1e-8) == (1e-8, True)
    assert len(nt.integrate(BODY, t_end=5).time) > 100  # at rest
    assert len(nt.integrate(BODY, t_end=5, integrator="lie-midpoint").time) == 101
    run = nt.integrate(BODY, t_end=5, tolerance=1e-8, **W)
    assert np.diff(run.time).max() == pytest.approx(run.step)
    swing = nt.simulate(PENDULUM, t_end=20, rotation=Rotation.from_euler("x", 1e-3))
    assert 2 * np.pi / OMEGA / np.diff(swing.time).max() > 30


def test_the_worst_member_decides():
    """Members within one grid have bits of their own."""
    slow, fast = (0.1, 0.0, 0.1), (5, -4, 9)
    how = {"t_end": 2, "load": LOAD, "tolerance": 1e-9, "store": 1, **GAUSS}
    many = nt.simulate_ensemble(BODY, material_angular_velocity=[slow, fast, fast], **how)
    one = nt.simulate(BODY, material_angular_velocity=fast, **how)
    assert many.attrs["tolerance"] == 1e-9
    assert many.attrs["error_estimate"] <= 1e-9
    assert np.array_equal(many.time, one.time)
    shown = nt.simulate_ensemble(BODY, material_angular_velocity=[slow, fast], t_end=2, load=LOAD, store=1)
    apart = np.diff(shown.time.values).max()
    assert np.linalg.norm(shown.material_angular_velocity, axis=2).max() * apart <= 0.05
    for member in (1, 2):
        assert np.array_equal(many.quaternion[member], one.quaternion)
    for i, velocity in enumerate((slow, fast)):
        start = {"material_angular_velocity": np.array(velocity, float), "rotation": np.eye(3)}
        known, _ = truth(Task(BODY, LOAD, start, 2.0, 1e-9, 1), [2.0])
        last = many.isel(member=i, time=-1).quaternion.values
        assert abs(Rotation.from_quat(last).as_matrix() - known[0].as_matrix()).max() <= 1e-9


WRONG = [{"step": 0.1, "tolerance": 1e-6}, {"tolerance": 0.2}, {"tolerance": -1}]
WRONG += [{"tolerance": 1e-6, "integrator": name} for name in ("exact", "continuous")]
test_what_is_refused = refused_as([lambda how=how: nt.integrate(BODY, t_end=1, **GAUSS | how, **W) for how in WRONG])


test_possible_outputs_of_long_runs = refused_as(
    {
        "figures": lambda: nt.simulate(nt.standard([1, 1, 2]), t_end=1e6, material_angular_velocity=(0.1, 0, 1)),
        "inertias": lambda: nt.simulate_ensemble(
            [nt.standard([3, 4, 5]), nt.standard([3, 4, 6])], t_end=1, step=1, load=nt.gravity_gradient(1e-3)
        ),
    }
)


def test_tolerance_below_ten_floors():
    """Two units of round-off in W move the attitude by 2 eps t |W| and more; far smaller ones take no longer."""
    how = GAUSS | W
    message = r"^tolerance = \S+ cannot be reached: .* two units .* moves the end by (\S+); use tolerance >= (\S+)$"
    with pytest.raises(ValueError, match=message) as info:
        nt.integrate(BODY, t_end=5, tolerance=1e-15, store="end", **how)
    floor, least = map(float, re.match(message, str(info.value)).groups())
    assert 1e-15 < floor < 1e-13
    assert 12 * floor <= least <= 13 * floor  # another first step finds a floor that differs by some percent
    run = nt.integrate(BODY, t_end=5, tolerance=least, store="end", **how)
    exact = nt.integrate(BODY, times=[5], integrator=Continuous(rtol=1e-13, atol=1e-15), **W)
    assert abs(run.directors[-1] - exact.directors[-1]).max() <= 1e-11
    with pytest.raises(ValueError, match=message):
        nt.integrate(BODY, t_end=1, tolerance=1e-101, **W)


def test_amplified_round_off():
    """A metre stick that swings about its middle axis: it is known to ten times what two units move its end by."""
    J = nt.inertia.shift(nt.inertia.of_cuboid(0.12, lengths=(0.03, 0.006, 1.0)), mass=0.12, offset=(0, 0, 0.4))
    stick = nt.heavy_top(J, mass=0.12, centre_of_mass=(0, 0, 0.4))
    start = Rotation.from_euler("x", np.pi / 2)
    told = r"the motion amplifies errors: .* moves the end by (\S+) rad, so it is known to (\S+) rad at best"
    with pytest.warns(UserWarning, match=told) as seen:
        run = nt.integrate(stick, t_end=9, rotation=start)
    moved, at_best = map(float, re.search(told, str(seen[0].message)).groups())
    assert len(seen) == 1
    assert 1e-4 < moved < 1
    assert (at_best, run.tolerance) == pytest.approx((10 * moved, 10 * moved), rel=0.06)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert nt.integrate(stick, t_end=5, rotation=start).tolerance < 1e-3
    told = "tolerance = 0.01 cannot be reached: " + told + r".*; use tolerance >= (\S+)$"
    with pytest.raises(ValueError, match=told) as refused:
        nt.integrate(stick, t_end=12, rotation=start, tolerance=0.01)
    moved, at_best, least = map(float, re.search(told, str(refused.value)).groups())
    assert (at_best, least) == pytest.approx((10 * moved, 12.5 * moved), rel=0.06)


def test_an_undeclared_kink_is_told():
    jump = nt.body_moment(lambda t: (1.0 if t < SWITCH else -1.0, 0, 0))
    with pytest.raises(ValueError, match=r"^tolerance = 1e-12 is not reached: with \d+ steps of order 16 the error is"):
        nt.integrate(nt.nontwisting([3, 4, 5]), t_end=1, load=jump, tolerance=1e-12, order=16, **GAUSS)
    coarse = nt.body_moment(lambda t: (np.sign(np.sin(4321 * t)), 0, 0))  # whose jumps no refinement meets
    with says():
        nt.integrate(nt.standard([3e-4, 4e-4, 5e-4]), t_end=1, load=coarse, tolerance=0.002, order=4, **GAUSS)
    declared = nt.body_moment(jump.terms[0].function, breakpoints=[SWITCH])
    run = nt.integrate(nt.nontwisting([3, 4, 5]), t_end=1, load=declared, tolerance=1e-12, **GAUSS)
    assert run.material_angular_velocity[-1, 0] == pytest.approx((2 * SWITCH - 1) / 3, abs=1e-13)


@pytest.mark.filterwarnings("ignore:1 of 2 members", "ignore:2 of 2 members")
def test_members_meet_a_jump():
    """A thruster about d3 that stops at 0.1 rad/s, beside a moment of time under which W_3 is known."""

    def law(t, d, w):
        moment = np.where(d[2] @ w < 0.1, 0.5, 0.0) + 0.4 * np.sin(2.5 * t)
        return moment * d[2]

    how = {"t_end": 40.0, "load": nt.moment(law, compiled=True)}
    for other, last in ((0.2, 0.2 + 0.4 / 150 * (1 - np.cos(100))), (0.03, np.nan)):
        many = nt.simulate_ensemble(
            nt.standard([40, 50, 60]), material_angular_velocity=[(0, 0, 0.0468), (0, 0, other)], **how
        )
        assert many.status.values.tolist() == [Status.JUMP, Status.JUMP if np.isnan(last) else Status.OK]
        found = many.material_angular_velocity.values[1, -1, 2]
        assert found == pytest.approx(last, abs=1e-12, nan_ok=True)


def test_jump_between_stages():
    """It lies behind the last stage of a step, before a node of both grids, whose runs agree to round-off."""

    def law(t, d, w):
        return np.where(d[2] @ w < 0.1, 0.5, 0.0) * d[2]

    body, load = nt.standard([40, 50, 60]), nt.moment(law, compiled=True)
    for speed in (0.0468, 0.0734268198709379, 0.0801246916804313):
        with pytest.raises(SimulationError) as told:
            nt.simulate(body, t_end=40, load=load, material_angular_velocity=(0, 0, speed))
        assert told.value.status == Status.JUMP
        with pytest.raises(SimulationError, match="jumps with the state"):
            nt.integrate(body, t_end=40, load=load, material_angular_velocity=(0, 0, speed), store=7)
    declared = nt.moment(law, breakpoints=[6.0], compiled=True)  # where a node lies at the jump the run is right
    run = nt.simulate(body, t_end=40, load=declared, material_angular_velocity=(0, 0, 0.05))
    assert run.material_angular_velocity.values[-1, 2] == pytest.approx(0.1, abs=1e-9)


def test_saturation():
    def clipped(t, directors, w):
        return -0.2 * np.minimum(np.maximum(5 * w, -1), 1)

    def smooth(t, directors, w):
        return -0.2 * np.tanh(5 * w)

    how = {"t_end": 20, "material_angular_velocity": (1, 2, 0.5), "store": "end", "tolerance": 1e-12, **GAUSS}
    message = r"^tolerance = 1e-12 is not reached: .* falls as if of order \d\.\d; make smooth, over a scale"
    with pytest.raises(ValueError, match=message):
        nt.integrate(BODY, load=compiled_load(clipped), **how)
    assert nt.integrate(BODY, load=compiled_load(smooth), **how).error_estimate <= 1e-12


@pytest.mark.parametrize("tolerance", [1e-5, 1e-7, 1e-9])
def test_kink_between_nodes(tolerance):
    """``J w' = -0.3 min(2 w, 1)``: w falls evenly until it is 1/2, and then decays; distances of runs do not fall."""

    def limited(t, directors, w):
        return 0.3 * np.minimum(np.maximum(-2 * w, -1), 1)

    load, kink = compiled_load(limited), 2.5 / 0.15
    angle = 3 * kink - 0.075 * kink**2 + 0.5 / 0.3 * (1 - np.exp(-0.3 * (30 - kink)))
    how = {"t_end": 30, "material_angular_velocity": (0, 0, 3), "load": load, "tolerance": tolerance, "store": "end"}
    run = nt.integrate(nt.standard([1.5, 1.8, 2]), **how)
    turn = Rotation.from_rotvec([0, 0, angle]).inv() * Rotation.from_matrix(run.directors[-1].T)
    assert turn.magnitude() <= tolerance


OMEGA, PENDULUM = 2.7, nt.heavy_top([4, 6, 4], mass=4 * 2.7**2 / 9.81, centre_of_mass=(0, 0, -1))


def swung(angle, t):
    """``θ = 2 arcsin(k sn(K - ωt))``."""
    k = np.sin(angle / 2)
    return Rotation.from_euler("x", 2 * np.arcsin(k * ellipj(ellipk(k**2) - OMEGA * t, k**2)[0]))


def hanging(t, directors, w):
    return 4 * OMEGA**2 * np.cross(-directors[2], np.array([0, 0, -1.0]))


SWINGS = [(0.1, 1e-4), (1e-5, 1e-4), (1e-5, 1e-10)]


@pytest.mark.parametrize(("angle", "tolerance"), [*SWINGS, (1e-3, None)])
def test_small_pendulum(angle, tolerance):
    """The first steps miss the swing, since they follow from the angular velocity.

    Of a moment that is a function the rate is not known either, and the first distances do not fall.
    """
    how = {"t_end": 60, "store": "end", "rotation": Rotation.from_euler("x", angle), "tolerance": tolerance or 1e-8}
    if tolerance is None:
        run = nt.simulate(nt.standard([4, 6, 4]), load=compiled_load(hanging), **how | {"t_end": 20})
    else:
        run = nt.simulate(PENDULUM, **how)
        assert round(60 / run.step) < 1000
    assert (nt.rotation(run)[-1].inv() * swung(angle, float(run.time[-1]))).magnitude() < how["tolerance"]
    assert run.error_estimate <= how["tolerance"]


def test_slow_start_of_pendulum():
    """A bob of 28 kg on 67 m hardly moves at first: no step resolves the moment until they are a thousandth as long."""
    J, weight = [28 * 67**2, 28 * 67**2, 2.8], 28 * 67 * 9.81
    load = nt.moment(lambda t, d, w: (-weight * d[2][1], weight * d[2][0], 0.0), compiled=True)
    how = {"rotation": Rotation.from_rotvec([np.pi - 0.05, 0, 0]), "material_angular_velocity": (5e-5, 3e-5, 0)}
    run = nt.simulate(nt.standard(J), times=np.linspace(0, 3600, 101), load=load, **how)
    exact = nt.simulate(nt.heavy_top(J, 28, (0, 0, 67), physical=False), times=run.time.values, tolerance=1e-10, **how)
    assert run.error_estimate <= 1e-8
    assert abs(run.directors - exact.directors).max() < 2e-8


def test_gyrocompass():
    """The moment of a weight that turns with the earth is a function; the nutation is faster than the body turns."""
    latitude, earth, momentum, inertia, period = np.radians(50.0), 7.292e-5, 10.0, 0.5, 1000.0
    c, s = np.cos(latitude), np.sin(latitude)
    weight = 1 / (earth * c / momentum * (period / (2 * np.pi)) ** 2 - inertia / momentum**2)

    def hanging(t, d, w):
        return weight * np.cross(d[2], np.array([c * np.cos(earth * t), c * np.sin(earth * t), s]))

    up, north = np.array([c, 0, s]), np.array([-s, 0, c])
    d1 = Rotation.from_rotvec(np.radians(5) * up).apply(north)
    start = Rotation.from_matrix(np.stack([d1, np.cross(up, d1), up], axis=1))
    load, times = nt.moment(hanging, compiled=True) + nt.rotor((1, 0, 0), momentum), np.arange(0, 2000.0)
    how = {"times": times, "rotation": start, "load": load, "angular_velocity": (0, 0, earth)}
    run = nt.simulate(nt.standard([inertia] * 3), **how)
    assert run.error_estimate <= 1e-8
    assert round(2000 / run.step) < 100_000  # of an order that follows the nutation in few
    axis, turned = run.directors.sel(director=1).values, Rotation.from_rotvec(np.outer(earth * times, [0, 0, 1]))
    azimuth = (np.cross(turned.apply(north), axis) * turned.apply(up)).sum(axis=1)
    zeros = np.flatnonzero(azimuth[:-1] * azimuth[1:] < 0)
    assert np.diff(times[zeros]) == pytest.approx(np.full(3, period / 2), rel=0.005)


def test_round_off_is_amplified():
    """A body that turns over time and again about its middle axis, from 1e-6 rad/s across it."""
    how = {"t_end": 20, "material_angular_velocity": (1e-6, 2 * np.pi, 0)}
    with pytest.warns(UserWarning, match="; the motion amplifies round-off: a shorter run is known better$"):
        nt.integrate(nt.standard([1, 2, 3]), **how)


def test_gyration_behind_many_kinks():
    """Kinks that are 0.5 s apart, then 60 s that begin with steps in which the rotor turns W by some rad."""
    body, rng = nt.standard([[22, 0.4, -0.3], [0.4, 20.5, 0.2], [-0.3, 0.2, 24.5]]), np.random.default_rng(3)
    times, moments = np.arange(0, 30.5, 0.5), 0.02 * rng.normal(size=(61, 3))
    moments[[0, -1]] = 0
    load = nt.wheel((1, 2, 2), 0.05, speed=500) + nt.body_moment(times, moments)
    how = {"load": load, "material_angular_velocity": (0.012, -0.015, 0.018)}
    run = nt.simulate(body, t_end=90, tolerance=1e-8, **how)
    exact = nt.simulate(body, t_end=90, step=0.05, integrator="gauss", order=8, **how)
    ends = (nt.rotation(one)[-1] for one in (run, exact))
    assert (next(ends).inv() * next(ends)).magnitude() < 1e-8


def test_fast_wheels_are_resolved(monkeypatch):
    """W turns by 600 rad/s in a body that turns by 0.04 rad/s; steps that miss it do not get better for long."""
    monkeypatch.setattr(tolerance, "MANY", 100)
    how = {"load": nt.wheel("z", 0.05, speed=1e6), "material_angular_velocity": (0.01, 0.02, 0.03)}
    run = nt.simulate(nt.standard([20, 80, 90]), t_end=10, **how)
    exact = nt.simulate(nt.standard([20, 80, 90]), times=run.time, integrator="exact", **how)
    np.testing.assert_allclose(run.material_angular_velocity, exact.material_angular_velocity, atol=1e-10)
    monkeypatch.setattr(tolerance, "ENOUGH", 3000)
    with pytest.warns(UserWarning, match=r"gyrate, which 5\.6e\+03 steps resolve: shorten the run, or give step=$"):
        nt.simulate(nt.standard([20, 80, 90]), t_end=10, **how)


@pytest.mark.parametrize(("t_end", "shown"), [(2, 0.2), (50, 50 * 100 / np.sqrt(1.2) / 20_000)])
def test_stored_gyration(t_end, shown):
    """A body that hardly turns, and W that turns in it at the rate h / √(J₁ J₂)."""
    run = nt.simulate(
        nt.standard([1, 1.2, 1.5]), t_end=t_end, load=nt.rotor((0, 0, 1), 100.0), angular_velocity=(0.1, 0, 0)
    )
    turned = np.diff(run.time) * 100 / np.sqrt(1.2)
    assert 0.99 * shown < turned.max() <= shown * (1 + 1e-9)


def test_rate_of_a_gyration():
    """Of ``J W' = H × W``; a body that may not turn about its third axis sees H along that alone."""
    J, h = np.array([3.0, 4.0, 5.0]), np.array([1.0, -2.0, 2.0])
    load = nt.rotor(h, [0, 1], [1.0, 3.0]) + nt.wheel(h, 0.5, speed=6, viscous=0.1)  # at most 6 kg m² s⁻¹ together
    free = gyration_rate(stacked(nt.standard(J)), load, 0, 2)
    assert free == pytest.approx(2 * np.sqrt(h @ (J * h) / J.prod()), rel=1e-12)
    held = gyration_rate(stacked(nt.nontwisting(J)), load, 0, 2)
    assert held == pytest.approx(2 * 2 / np.sqrt(J[0] * J[1]), rel=1e-12)
    assert gyration_rate(stacked(nt.standard(J)), nt.damping(1), 0, 2) == 0


@pytest.mark.parametrize(("angle", "tolerance"), [(0.0, None), (1e-12, 1e-10)])
def test_equilibrium(angle, tolerance):
    """Its angular velocity is round-off, relative to which nothing can be computed."""
    start = {"rotation": Rotation.from_rotvec([angle, 0, 0]), "load": nt.spring(20.0, (0, 0, 1), (0, 0, 1.5))}
    run = nt.simulate(nt.standard([0.9, 3.4, 3.9]), t_end=20, tolerance=tolerance, **start)
    assert run.attrs["tolerance"] == (tolerance or 1e-8)
    assert nt.rotation(run).magnitude().max() <= angle + 1e-10


def test_slender_rod():
    """It swings by 150°; a quarter period is K(sin 75°)/ω, where it hangs straight."""
    radius = 1e-6
    rod = nt.heavy_top([1 / 3 + radius**2 / 4] * 2 + [radius**2 / 2], 1.0, [0, 0, 0.5])
    omega, start = np.sqrt(9.81 * 0.5 / rod.convected_inertia[0, 0]), np.radians(150)
    quarter = ellipk(np.sin(start / 2) ** 2) / omega
    how, calls = {"t_end": quarter, "rotation": nt.rotations.exp([np.pi - start, 0, 0])}, []
    run = nt.integrate(rod, **how)
    assert run.time.size < 200
    assert run.directors[-1, 2] == pytest.approx([0, 0, -1], abs=1e-8)
    nt.integrate(rod, load=nt.moment(lambda t, directors, w: calls.append(t) or (0, 0, 0)), **how)
    assert len(calls) < 30_000
    still, rubbing = np.zeros((1, 3)), nt.dry_friction(0.03, "x")
    assert largest_velocity(stacked(rod), still, rubbing, 0.0, quarter) == pytest.approx(2 * omega, rel=1e-3)


def test_molecule():
    """In picoseconds, and with inertias of 1e-47 kg m², it turns as a body of everyday size does in seconds."""
    J, W = np.array([3.0, 4, 5]), np.array([0.1, 2, 0.3])
    ends = []
    for small, fast in ((1e-47, 1e12), (1.0, 1.0)):
        run = nt.simulate(nt.standard(J * small), t_end=5 / fast, material_angular_velocity=W * fast)
        ends.append(run.quaternion.values[-1])
    assert ends[0] == pytest.approx(ends[1], abs=1e-8)


def test_fast_spin():
    run = nt.integrate(nt.standard([0.0147, 0.0015, 0.0162]), t_end=1, material_angular_velocity=(720, 3, 1))
    assert run.error_estimate <= run.tolerance == 1e-8


def require_bound(body, load, t_end, start):
    W = nt.integrate(body, t_end=t_end, load=load, material_angular_velocity=start).material_angular_velocity
    bound = largest_velocity(stacked(body), W[:1], load, 0.0, t_end, is_bound=True)
    assert np.linalg.norm(W, axis=1).max() <= bound * (1 + 1e-12)


def test_bounds_of_balls():
    """About one axis, under half the load or their weight, for 3 s; a bound is of moments that add up."""
    up, down = nt.body_moment([1, 4], [[0, 0, 4]] * 2), nt.space_moment([1, 4], [[0, 0, -2]] * 2)
    along = nt.director_forces([1, 4], [[[0, 2, 0], [0, 0, 0], [0, 0, 0]]] * 2, frame="body")
    ball, top = nt.standard([2, 2, 2]), nt.heavy_top([2, 2, 2], 3, (0, 0, 0.1))
    for body, load, fastest, bound in (
        (top, nt.Load(), np.sqrt(1.5**2 + 2.943 * 4 / 2), None),
        (ball, up + down, 1.5 + 0.5 * 6 / 2, 1.5 + 0.5 * 18 / 2),
        (ball, up + nt.rotor((0, 0, 1), [1, 4], [0, 24]), 1.5 + 0.5 * 12 / 2, None),
        (ball, up + along, 1.5 + 0.5 * 18 / 2, None),
        (ball, 9 * up + 3 * along + nt.damping(3), (36 + 6) / 3, None),
    ):
        about = stacked(body), np.array([[0, 0, 1.5]]), load, 1.0, 4.0, np.array([0.5])
        found = [largest_velocity(*about, is_bound) for is_bound in (False, True)]
        assert found == pytest.approx([fastest, bound or fastest], rel=1e-12)


@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(5))])
def test_damping_spins_slender_bodies(seed):
    """A start across its axis, J3 a thousandth of J1 and J2: without the coupling each of them exceeds the bound."""
    root = np.random.default_rng(seed).normal(size=(3, 3)) * 0.1
    require_bound(nt.standard([1.0, 1.0, 1e-3]), nt.damping(root @ root.T), 0.01, (1, 0.5, 0))


@pytest.mark.parametrize(
    ("name", "order", "tolerance"), [("lie-midpoint", 2, 1e-3), ("gauss", 4, 1e-5), ("split", 4, 1e-3)]
)
def test_low_orders(name, order, tolerance):
    """A tenth of the tolerance is accepted; their first steps, by the local estimate, were ten times finer."""
    how = {"t_end": 10, "material_angular_velocity": (0.3, 2, 0.1), "load": nt.sine((1, 0.3, 0), 1.0, frame="body")}
    run = nt.integrate(nt.standard([3, 4, 5]), tolerance=tolerance, integrator=name, order=order, **how)
    assert tolerance / 20 < run.error_estimate <= tolerance / 10


def test_moved_start():
    W, p = np.array([[1.0, -2, 3]]), Rotation.from_rotvec([[1, 2, 3]])
    begin = Starts(p.as_quat(), W, None, np.ones(1))
    moved = tolerance.moved(begin)
    assert abs(moved.velocity / W - 1) == pytest.approx(np.full((1, 3), tolerance.CHANGE), rel=1e-3)
    assert (p.inv() * Rotation.from_quat(moved.quaternion)).magnitude() == pytest.approx(tolerance.CHANGE, rel=1e-3)
    assert moved.load_scale - 1 == pytest.approx(tolerance.CHANGE, rel=1e-3)


def test_fast_sine_at_rest():
    times, phase, rate = np.sort(np.random.default_rng(0).uniform(0, 100, 99)), np.pi / 2, 2 * np.pi * 50
    run = nt.simulate(nt.standard([20, 80, 90]), times=times, load=nt.sine([1, 0, 0], 50, phase=phase))
    exact = (np.cos(phase) - np.cos(rate * times + phase)) / (20 * rate)
    assert abs(run.material_angular_velocity.values[:, 0] - exact).max() < 1e-8 * abs(exact).max()


def test_times_far_from_0():
    how = {"t_start": 1e9, "times": [1e9 + 1, 1e9 + 5], "material_angular_velocity": (1, 2, 0)}
    run, exact = (nt.simulate(nt.standard([3, 4, 5]), integrator=name, **how) for name in ("gauss", "exact"))
    assert 1e-8 < abs(run.directors - exact.directors).max() < run.tolerance
    with pytest.raises(ValueError, match="count them from a start at 0; or use tolerance >= "):
        nt.simulate(nt.standard([3, 4, 5]), tolerance=1e-8, **how)
