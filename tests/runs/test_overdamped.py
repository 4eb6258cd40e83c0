"""Bodies in thick oil: modes that decay up to 1e18 times in a run cost steps like the logarithm of that."""

import re
import warnings
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import or_long, thinned
from nontwist.errors import SimulationError, Status
from nontwist.integrators import Continuous
from nontwist.integrators.costs import damping_rate, largest_velocity, slowest_damping, swing_rate
from nontwist.loads import Load
from nontwist.models.stack import stacked

J, WEIGHT = 1.01, 9.81
OIL = nt.heavy_top([J, J, 0.01], mass=1, centre_of_mass=(0, 0, 1))
HANGING = Rotation.from_euler("x", np.pi - 1)
DAMPED = [1e2, 1e8]  # N m s: rates up to 1e10 1/s, in runs of up to 1e8 s


def how(c):
    return {"t_end": 10 * c / WEIGHT, "rotation": HANGING, "load": nt.damping(c)}


@cache
def pendulum(c, rate=0.0):
    """Return times and (angle, rate) of ``J θ'' + c θ' + m g l sin θ = 0`` from 1 rad and a rate, rad/s."""
    t = np.append(0.0, np.geomspace(0.01 * J / c, 10 * c / WEIGHT, 60))
    found = solve_ivp(
        lambda _, y: [y[1], -(WEIGHT * np.sin(y[0]) + c * y[1]) / J],
        (0, t[-1]),
        [1.0, rate],
        t_eval=t,
        method="LSODA",
        jac=lambda _, y: [[0.0, 1.0], [-WEIGHT * np.cos(y[0]) / J, -c / J]],
        rtol=3e-14,
        atol=1e-15 * WEIGHT / c,
    )
    return t, found.y


def angles(run):
    d = run.directors[:, 2]
    return np.arctan2(-d[:, 1], -d[:, 2])


@pytest.mark.parametrize(
    ("c", "scheme", "steps", "near"),
    [
        (1e8, {}, 1000, 2e-9),
        (1e8, {"load": nt.moment(lambda t, d, w: -1e8 * w, compiled=True)}, 2000, 2e-9),
        (1e2, {"integrator": "gauss", "order": 4}, 1e4, 2e-9),
        (1e2, {"integrator": "lie-midpoint"}, 1e5, 2e-3),
    ],
)
def test_pendulum_creeps_down(c, scheme, steps, near):
    """Nobody has chosen a step; of order 2 0.05 rad and less than 5 % of a decay in the first ones.

    The damping by a function of the state at the start begins the steps, and bounds the velocity.
    """
    run = nt.integrate(OIL, **how(c) | scheme)
    angle, rate = pendulum(c)[1][:, -1]
    assert angles(run)[-1] == pytest.approx(angle, rel=near, abs=0)
    assert -run.material_angular_velocity[-1, 0] == pytest.approx(rate, rel=max(2e-8, near), abs=0)
    assert run.segments.steps < steps
    assert run.warning is None


STIFF = {
    "wheel": nt.wheel("z", 0.5, speed=20, friction=lambda speed: 1e6 * speed),
    "memory": nt.memory_load(
        lambda t, z, d, w: 1e6 * (w[:1] - z), lambda t, z, d, w: z * np.ones(3), [9], compiled=True
    ),
    "function": nt.moment(lambda t, d, w: -1e7 * w, compiled=True),
}


@pytest.mark.parametrize("load", STIFF)
def test_unresolved_loads(load):
    body, how = nt.standard([3, 4, 5]), {"step": 0.01, "order": 4, "load": STIFF[load]}
    for call in (
        lambda: nt.simulate(body, t_end=0.1, material_angular_velocity=(0, 0, 1), **how),
        lambda: nt.simulate_ensemble(body, t_end=0.1, material_angular_velocity=np.eye(3), **how),
        lambda: nt.stepper(body, integrator="gauss", **how),
    ):
        with pytest.warns(UserWarning, match=r"which step = 0\.01 s does not resolve"):
            call()


def test_a_damper_that_begins_later():
    """About a principal axis W stays, then ``W = W_0 exp(-c (t - 1)/J)``."""
    c, times = 2e6, np.array([1.0, 1.0 + 1e-6, 5.0])
    load = nt.moment(lambda t, d, w: -np.where(t > 1, c, 0.0) * w, breakpoints=(1.0,), compiled=True)
    run = nt.integrate(nt.standard([1.5, 2, 2.5]), times=times, angular_velocity=(0, 0.3, 0), load=load)
    left = np.array([1, np.exp(-1), 0])
    assert run.material_angular_velocity[:, 1] == pytest.approx(0.3 * left, abs=1e-9)
    angle = Rotation.from_quat(run.quaternion).as_rotvec()[:, 1]
    assert angle == pytest.approx(0.3 * (1 + 2.0 / c * (1 - left)), abs=1e-9)
    assert run.segments.steps < 6000


@pytest.mark.parametrize(("integrator", "c"), [("lie-midpoint", 2e3), ("split", 1e4)])
def test_velocities_underflow(integrator, c):
    """By a function of the state, whose derivatives are differences; a step resolves no decay, as each run says."""
    how = {"t_end": 2, "step": 2e-3, "material_angular_velocity": (1, 2, 3), "integrator": integrator}
    load = nt.moment(lambda t, d, w: -c * w, compiled=True)
    with pytest.warns(UserWarning, match="does not resolve"):
        run = nt.integrate(nt.standard([1.0, 2, 3]), **how, load=load)
    assert np.linalg.norm(run.material_angular_velocity[-1]) < 1e-270


@pytest.mark.parametrize(
    ("scheme", "make", "size"),
    [
        *(("split", make, size) for make in (nt.nontwisting, nt.standard) for size in (1e-12, 1.0)),
        ("energy-momentum", nt.standard, 1e-12),
    ],
)
def test_each_step_shrinks_a_decay(scheme, make, size):
    """By ``(1 - x/2)/(1 + x/2)``, x = c h/J, about a principal axis, until it is round-off."""
    how = {"t_start": 1, "t_end": 2, "material_angular_velocity": (size, 0, 0), "integrator": scheme, "order": 2}
    run = nt.integrate(make([1.0, 2, 3]), **how, load=nt.damping(1e3))
    x, rates = 1e3 * run.step, run.material_angular_velocity[:, 0] / size
    assert rates[20] == pytest.approx(((1 - x / 2) / (1 + x / 2)) ** 20, rel=1e-12, abs=0)
    assert abs(rates[-1]) < 1e-17


@pytest.mark.filterwarnings("ignore:a table of the load ends")
def test_push_is_resolved():
    """About a principal axis ``W = M/c (1 - exp(-λ t))`` while it lasts, and ``W exp(-λ t)`` behind it."""
    rate, c, M, until = 1e7, 2e7, 3e7, 1.7  # J = 2, W up to 1.5
    t = np.sort(np.concatenate([np.geomspace(0.1 / rate, 1, 20), until + np.geomspace(0.1 / rate, 1, 20)]))
    load = nt.damping(c) + nt.body_moment([0, until], [[0, M, 0], [0, M, 0]])
    run = nt.integrate(nt.standard([1.5, 2, 2.5]), t_end=5, times=t, load=load)
    since = np.maximum(t - until, 0.0)
    expected = M / c * (1 - np.exp(-rate * np.minimum(t, until))) * np.exp(-rate * since)
    turned = M * np.minimum(t, until) / c - 2.0 * expected / c
    assert run.material_angular_velocity[:, 1] == pytest.approx(expected, abs=1e-8 * 1.5)
    angle = Rotation.from_quat(run.quaternion).as_rotvec()[:, 1]
    assert angle == pytest.approx(turned, abs=1e-8)


TURNED = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
SLENDER = [[1.2, 0.01, 0], [0.01, 1.25, -0.05], [0, -0.05, 0.09]]
SLANTED = {  # body, damping, start, velocity, times; tolerance, and steps at most
    "drag": (
        nt.heavy_top(SLENDER, mass=2, centre_of_mass=(0.05, 0.02, 0.6)),
        TURNED @ np.diag([40.0, 900.0, 9e3]) @ TURNED.T,
        Rotation.from_rotvec([2.0, 0.5, -0.3]),
        (3, -2, 4),
        [0.001, 0.1, 2.0],
        (1e-8, 600),
    ),
    "oil": (OIL, 1e4, HANGING, (3, -6, 8), [1e5 / WEIGHT], (None, 200)),
}


@pytest.mark.filterwarnings("ignore:.*will take")
@pytest.mark.parametrize("case", SLANTED)
def test_axes_with_different_rates(case):
    """Of 30 to 2e5 1/s under drag along slanted axes, and of 1e4 and 1e6 1/s in oil: by SciPy."""
    body, C, start, W0, t, (tolerance, steps) = SLANTED[case]
    how = {"times": t, "load": nt.damping(C), "rotation": start, "material_angular_velocity": W0}
    truth = nt.integrate(body, **how, integrator=Continuous("LSODA", rtol=1e-11, atol=1e-13))
    run, found = nt.integrate(body, **how, tolerance=tolerance), truth.material_angular_velocity
    assert (truth.rotation.inv() * run.rotation).magnitude().max() <= (tolerance or 1e-9)
    assert abs(run.material_angular_velocity - found).max() <= 1e-8 * np.linalg.norm(W0)
    assert run.segments.steps < steps
    if tolerance is None:
        tilts = [np.linalg.norm(one.directors[-1, 2, :2]) for one in (truth, run)]
        assert tilts[1] == pytest.approx(tilts[0], rel=1e-6, abs=0)
        assert run.material_angular_velocity[-1] == pytest.approx(found[-1], rel=1e-6, abs=1e-12 * WEIGHT / 1e4)


@pytest.mark.parametrize("rate", [0, 10])
def test_ensembles_take_such_steps(rate):
    task = how(1e4) | {"material_angular_velocity": (rate, 0, rate)}
    runs = nt.simulate_ensemble(OIL, **task, load_scale=[0.5, 1, 2])
    alone = [nt.integrate(OIL, **task | {"load": f * nt.damping(1e4)}, store="end") for f in (0.5, 1, 2)]
    W = runs.material_angular_velocity.values[:, -1]
    assert pytest.approx(W, rel=1e-6, abs=1e-12) == [run.material_angular_velocity[-1].tolist() for run in alone]


def test_what_damping_bounds():
    systems, W = stacked(OIL), np.zeros((1, 3))
    for c in DAMPED:
        slow = slowest_damping(systems, nt.damping(c))
        assert slow == pytest.approx(c / J)
        assert swing_rate(systems, nt.damping(c)) == pytest.approx(2 * WEIGHT / (c + np.sqrt(c**2 - 4 * J * WEIGHT)))
        fastest = largest_velocity(systems, W, nt.damping(c), 0, 10 * c / WEIGHT)
        assert abs(pendulum(c)[1][1]).max() <= fastest <= WEIGHT / c * np.sqrt(J / 0.01) * 1.001
    assert swing_rate(systems, nt.damping(0.1)) == swing_rate(systems, Load())
    assert slowest_damping(systems, nt.damping([1, 1, 0])) == 0
    faster = largest_velocity(systems, np.array([[0, 0, 3.0]]), nt.damping(1e4), 0, 1e3)
    assert faster == pytest.approx(3.0, rel=1e-2)


@pytest.mark.parametrize(("scheme", "rate"), thinned(3, ["split", "energy-momentum"], [0.0, 10.0]))
def test_schemes_that_must_resolve(scheme, rate):
    """With the steps, which are those of a run that takes the advice."""
    words = r"choose the integrator gauss without step=, which takes about (\d+) steps of up to (\S+) s$"
    task = how(1e4) | {"material_angular_velocity": (-rate, 0, 0)}
    for more in ({}, {"tolerance": 1e-6}):
        with pytest.raises(ValueError, match=words) as refused:
            nt.simulate(OIL, **task, integrator=scheme, **more)
        run = nt.integrate(OIL, **task, **more, integrator="gauss")
        assert angles(run)[-1] == pytest.approx(pendulum(1e4, rate)[1][0, -1], rel=1e-6, abs=0)
        steps, longest = re.search(words, str(refused.value)).groups()
        assert run.segments.steps == pytest.approx(int(steps), rel=0.5)
        assert 1 / 3 < max(run.segments.sizes) / float(longest) < 3
    coming = nt.Problem(OIL, t_end=1, load=nt.damping(100), integrator=scheme).forecast()
    assert coming.step <= 1e-4 * (1 + 1e-9)


def test_too_long_step():
    message = r"1e\+06 1/s, which step = 10.1937 s does not resolve: .*; try step <= 8e-06, or none: a tolerance begins"
    with pytest.warns(UserWarning, match=message):
        nt.simulate(OIL, **how(1e4), step=how(1e4)["t_end"] / 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nt.simulate(OIL, **how(1e4))


@pytest.mark.parametrize(
    ("rate", "most", "scheme"),
    or_long(
        [(1.0, "1e\\+19", {}), *((0.0, "4e\\+20", one) for one in ({}, {"tolerance": 1e-6}, {"integrator": "split"}))],
        [(1.0, "1e\\+19", one) for one in ({"tolerance": 1e-6}, {"integrator": "split"})],
    ),
)
def test_round_off_refuses(monkeypatch, scheme, rate, most):
    """A run up to the time that is named, and one over the whole time in the step that is named."""
    c, marched, from_rest = 1e12, [], f"t_end <= .* or{', from rest,' * (rate != 0)} the integrator lie-midpoint"
    task = how(c) | {"material_angular_velocity": (-rate, 0, 0)}
    with monkeypatch.context() as patch:
        patch.setattr("nontwist.driver.completion.checked_march", lambda *arguments: marched.append(arguments))
        with pytest.raises(ValueError, match=from_rest) as refused:
            nt.simulate(OIL, **task | scheme)
    assert not marched
    assert scheme.get("integrator") or re.search(f"of which at most {most} are resolved", str(refused.value))
    longest, step = (float(x) for x in re.findall(r"(?:t_end <=|step =) (\S+) s", str(refused.value)))
    with pytest.raises(ValueError, match="t_end <= ") as refused:
        nt.simulate(OIL, **task | {"t_start": 3 * longest, "t_end": 3 * longest + task["t_end"]} | scheme)
    assert float(re.search(r"t_end <= (\S+) s", str(refused.value))[1]) == pytest.approx(4 * longest, rel=0.05)
    short = nt.integrate(OIL, **task | {"t_end": longest}, tolerance=1e-6)
    assert 1 - angles(short)[-1] == pytest.approx(WEIGHT * np.sin(1) / c * longest - rate * J / c, rel=1e-3)
    with pytest.warns(UserWarning, match="does not resolve"):
        crept = nt.integrate(OIL, **how(c), step=step, integrator="lie-midpoint")
    assert angles(crept)[-1] == pytest.approx(2 * np.arctan(np.tan(0.5) * np.exp(-10)), rel=1e-6, abs=0)


@pytest.mark.parametrize(
    ("c", "rate", "tolerance"), [(1e2, 0.0, 1e-6), (1e8, 0.0, 1e-10), (1e2, 0.1, None), (1e8, -100.0, None)]
)
def test_states_between_steps(c, rate, tolerance):
    """While the velocity comes up or decays, in about J/c, and later; relative to the largest velocity.

    One at the start turns the body by about W J/c and is gone.
    """
    t, (angle, rates) = pendulum(c, rate)
    task = how(c) | {"material_angular_velocity": (-rate, 0, 0)}
    run = nt.integrate(OIL, **task)
    assert angles(run)[-1] == pytest.approx(angle[-1], rel=1e-6, abs=0)
    assert -run.material_angular_velocity[-1, 0] == pytest.approx(rates[-1], rel=1e-6, abs=0)
    assert run.segments.steps < 500
    assert len(run.time) < 400
    within = nt.integrate(OIL, **task, times=t, tolerance=tolerance)
    near = tolerance or 1e-8
    assert abs(angles(within) - angle).max() <= near
    assert abs(within.material_angular_velocity[:, 0] + rates).max() <= near * abs(rates).max()


@pytest.mark.parametrize("size", [0.1, 100.0])
@pytest.mark.parametrize("is_function", [False, True])
@pytest.mark.parametrize("c", DAMPED)
def test_damping_alone(c, size, is_function):
    """``W = W_0 exp(-c t/J)`` about a principal axis."""
    load = nt.moment(lambda t, d, w: -c * w, compiled=True) if is_function else nt.damping(c)
    x = np.append(0.0, np.geomspace(0.01, 1e6, 20))  # c t/J
    run = nt.integrate(nt.standard([3, 4, 5]), times=x * 4 / c, load=load, material_angular_velocity=(0, size, 0))
    expected, turned = size * np.exp(-x), size * 4 / c * (1 - np.exp(-x))
    assert run.material_angular_velocity[:, 1] == pytest.approx(expected, abs=1e-8 * size)
    assert np.unwrap(2 * np.arctan2(run.quaternion[:, 1], run.quaternion[:, 3])) == pytest.approx(turned, abs=1e-8)
    assert run.segments.steps < (5000 if is_function else 200)


@pytest.mark.parametrize(("viscous", "is_function"), [(1.0, False), (1e3, True)])
def test_wheel_stops_at_once(viscous, is_function):
    """``Ω' = -b (1/I + 1/(J - I)) Ω``, at rates of 200 and 2e5 1/s in a run of 10 s."""
    friction = {"friction": lambda speed: viscous * speed} if is_function else {"viscous": viscous}
    load = nt.wheel("z", 0.005, speed=100, **friction)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = nt.simulate(nt.standard([3, 4, 5]), t_end=10, angular_velocity=(0, 0, 0.3), load=load)
    rate = viscous * (1 / 0.005 + 1 / (5 - 0.005))
    assert run.sizes["time"] < 1500
    assert run.wheel_speed.values[:, 0] == pytest.approx(100 * np.exp(-rate * run.time.values), abs=1e-8)
    assert run.wheel_loss.values[-1, 0] == pytest.approx(100**2 / 2 * viscous / rate, rel=1e-8)


def test_actuator_without_lag():
    """``J W' = -z, z' = -c (z - W)``, about x: a linear motion."""
    c = 1e5
    functions = lambda t, z, d, w: -c * (z - w[:1]), lambda t, z, d, w: -z[0] * np.array([1, 0, 0])
    lag = nt.memory_load(*functions, [0.0], scale=1.0, compiled=True)
    run = nt.integrate(nt.standard([3.0, 4, 5]), t_end=10, angular_velocity=(0.3, 0, 0), load=lag)
    expected = [expm(np.array([[0, -1 / 3], [c, -c]]) * t) @ [0.3, 0] for t in run.time[::40]]
    found = np.column_stack([run.material_angular_velocity[:, 0], run.states.internal[:, 0]])[::40]
    assert found == pytest.approx(np.array(expected), abs=1e-8 * 0.3)
    assert run.segments.steps < 700


def test_fastest_rate_of_wheels():
    load = nt.wheel("x", 0.2, viscous=3.0) + nt.wheel((1, 2, 2), 0.1, 5, viscous=2.0) + nt.wheel("y", 0.3)
    n, b = np.array([[1, 0, 0], [1 / 3, 2 / 3, 2 / 3], [0, 1, 0]]), np.diag([3.0, 2.0, 0])
    own = np.diag([0.2, 0.1, 0.3])
    carrier = np.linalg.solve(np.diag([3.0, 4, 5]) - n.T @ own @ n, n.T @ b)  # W' of the speeds of the wheels
    slopes = -np.linalg.solve(own, b) - n @ carrier
    assert damping_rate(stacked(nt.standard([3, 4, 5])), load) == pytest.approx(abs(np.linalg.eigvals(slopes)).max())


def test_infinite_damping():
    load = nt.moment(lambda t, d, w: (-1e200 * w[0], -1e200 * w[1], -1e199 * w[2]), compiled=True)
    about = {"t_end": 1, "load": load, "material_angular_velocity": (1, 0.1, 2)}
    with pytest.raises(ValueError, match="of which at most 1e\\+19 are resolved"):
        nt.simulate(nt.standard([3, 4, 5]), **about)
    with pytest.warns(UserWarning, match="does not resolve"), pytest.raises(SimulationError) as failed:
        nt.simulate(nt.standard([3, 4, 5]), step=0.1, **about)
    assert failed.value.status == Status.STALLED


def test_solver_of_too_many_steps(monkeypatch):
    """By 1e6 steps of 6.3/ρ; just below it begins."""
    longest = 1e6 * 6.3 * 0.01 / 1e4
    task = {"integrator": "continuous", "rotation": HANGING, "load": nt.damping(1e4)}
    with pytest.raises(ValueError, match="the integrator gauss without step=, which takes about"):
        nt.simulate(OIL, times=[0, 1.001 * longest], **task)
    monkeypatch.setattr("nontwist.driver.completion.checked_march", lambda *arguments: 1 / 0)
    with pytest.warns(UserWarning, match="will take"), pytest.raises(ZeroDivisionError):
        nt.simulate(OIL, times=[0, 0.999 * longest], **task)


@pytest.mark.parametrize("grid", [{"t_end": 5000, "step": 50.0}, {"t_end": 5000}, {"times": [0, 5000.0]}])
def test_scipys_implicit_solvers(grid, monkeypatch):
    """Of runs of a million steps, after few: what is said is what gauss takes, whatever the words of the failure."""
    monkeypatch.setattr("nontwist.integrators.continuous.TOO_FAST", "{} needs more than {} steps, after {} it is {}")
    how = {"rotation": Rotation.from_euler("x", 1.2), "load": nt.damping(1e4)}
    body = nt.heavy_top([1.1, 1.0, 0.4], mass=1.3, centre_of_mass=(0, 0, 0.8))
    with pytest.raises(
        (ValueError, SimulationError), match="e the integrator gauss without step=, which takes"
    ) as told:
        nt.simulate(body, integrator=Continuous("Radau"), **how, **grid)
    steps = int(re.search(r"about (\d+) steps", str(told.value))[1])
    if isinstance(told.value, SimulationError):
        assert told.value.status == Status.TOO_MANY
        assert "after 250 it" in str(told.value)
    else:
        assert grid == {"t_end": 5000}
    assert nt.integrate(body, t_end=5000, **how).segments.steps == pytest.approx(steps, rel=0.5)


def test_more_steps_than_chosen():
    how = {"rotation": Rotation.from_euler("x", 1.2), "load": nt.damping(1e4) + nt.sine((1, 0, 0), 10.0)}
    body = nt.heavy_top([1.1, 1.0, 0.4], mass=1.3, centre_of_mass=(0, 0, 0.8))
    with pytest.raises(
        ValueError, match=r"4e\+07 steps, more than 1e\+07; choose a step of about 0\.025 s with gauss$"
    ):
        nt.simulate(body, t_end=1e6, **how)
    with pytest.warns(UserWarning, match="damping slows the body"):
        run = nt.simulate(body, t_end=5, step=0.025, store="end", **how)
    assert np.allclose(run.directors.values[-1], nt.simulate(body, t_end=5, **how).directors.values[-1], atol=1e-9)
