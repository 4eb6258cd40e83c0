"""The stepper: the bits of a run, balances, failures that leave the state alone, branches, copies, threads."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, compiled_load, or_long
from nontwist.errors import SimulationError, Status
from nontwist.integrators import EnergyMomentum, Gauss, LieMidpoint
from refusals import refused_as, said, says

H, N = 1 / 64, 64  # so that t_end / N is the step, and all nodes are the same floats
M, m = (9.0, -4.0, 7.0), (3.0, 5.0, -2.0)
START = {"rotation": Rotation.from_rotvec([0.4, -0.3, 0.8]), "material_angular_velocity": (1.1, -0.7, 0.4)}
SCHEMES = [("lie-midpoint", 2), ("gauss", 2), ("gauss", 4), ("gauss", 8), ("energy-momentum", 2)]
FREE = nt.standard([[3.1, 0.2, -0.3], [0.2, 4.2, 0.1], [-0.3, 0.1, 5.5]])
TOP = nt.heavy_top([2, 2, 0.5], mass=1.5, centre_of_mass=[0, 0, 0.6])


def constant(body, space):
    return nt.body_moment(lambda t: body) + nt.space_moment(lambda t: space)


def states(loop, count=N, body=M, space=m):
    return [loop.step(body, space) for _ in range(count)]


def drag(t, directors, w):
    return -0.1 * t * w[0] * abs(w[0]), 0.2 * directors[2][1], -0.1 * w[2]


OF_TIME = nt.sine((1, 2, 0), 0.7) + nt.sine((0, 1, 0), 1.3, frame="space") + nt.damping([0.1, 0.2, 0.3])
KINDS = "standard", "suslov", "heavy_top", "nontwisting", "suslov"
CASES = [(body, *scheme, OF_TIME) for body, scheme in zip(KINDS, SCHEMES, strict=True)]
CASES += [("standard", "gauss", 8, compiled_load(drag)), ("standard", "energy-momentum", 2, nt.moment(drag))]


@pytest.mark.parametrize(("body", "integrator", "order", "load"), or_long(CASES[::3], CASES[1::3] + CASES[2::3]))
def test_continues_a_run(body, integrator, order, load):
    """Of more than a turn: the quaternion does not jump, whatever its sign is in the run."""
    system, how = BODIES[body](), {"integrator": integrator, "order": order}
    loop, how = nt.stepper(system, H, load=load, **how), how | {"step": H, "project": True}
    how["load"] = load + constant(M, m)
    start = {"material_angular_velocity": (9, 0, 0)}
    whole = nt.integrate(system, t_end=2 * H * N, **start, **how)
    for first in (nt.simulate, nt.integrate):
        before = loop.reset(start=first(system, t_end=H * N, **start, **how))
        assert before.time == H * N
        found = states(loop)
        assert np.dot(before.quaternion, found[0].quaternion) > 0.99
        assert [state.time for state in found] == whole.time[-N:].tolist()
        for name in ("quaternion", "material_angular_velocity"):  # a run keeps the attitude, not the sign
            mine = np.array([getattr(state, name) for state in found])
            assert np.array_equal(abs(mine), abs(getattr(whole, name)[-N:]))
        assert [state.load_work for state in found] == whole.load_work[-N:].tolist()
        reaction = np.zeros(N) if system.axis is None else -whole.multipliers[-N:, -1]
        assert [state.reaction_moment for state in found] == reaction.tolist()
        assert loop.rotation.as_matrix() == pytest.approx(whole.directors[-1].T, abs=1e-15)


def test_constraint_bears_axial_moment():
    loop = nt.stepper(nt.nontwisting([3, 4, 5]), 0.01)
    assert loop.state.reaction_moment == 0
    state = loop.step(body_moment=(0, 0, 2))
    assert state.reaction_moment == pytest.approx(-2)
    assert (state.material_angular_velocity, state.load_work) == ((0, 0, 0), 0)
    with pytest.raises(ValueError, match="project=True removes it"):
        loop.reset(material_angular_velocity=(1, 0, 1))
    assert loop.reset(material_angular_velocity=(1, 0, 1), project=True).material_angular_velocity == (1, 0, 0)


def test_starts_at_rest():
    loop = nt.stepper(FREE, H)
    first = loop.state
    assert (loop.time, first.steps, first.load_work) == (0, 0, 0)
    assert loop.material_angular_velocity == (0, 0, 0)
    assert loop.rotation.magnitude() == 0
    states(loop, 3)
    assert (loop.state.steps, loop.state != first) == (3, True)
    assert loop.reset() == first
    assert hash(loop.state) == hash(first)
    body, start = loop.reset(**START), {"rotation": START["rotation"]}
    turned = START["rotation"].apply(START["material_angular_velocity"])
    assert body.angular_velocity == pytest.approx(turned, abs=1e-15)
    again = loop.reset(**start, angular_velocity=turned)
    assert again.material_angular_velocity == pytest.approx(body.material_angular_velocity, abs=1e-15)


def test_time_is_counted():
    loop = nt.stepper(FREE, 0.1)
    loop.reset(time=3.7)
    assert [loop.step().time for _ in range(1000)] == [3.7 + k * 0.1 for k in range(1, 1001)]


def test_forms_of_a_moment():
    loop = nt.stepper(FREE, H)
    now, found = loop.reset(**START), set()
    forms = (1, 0, 2), [1.0, 0.0, 2.0], np.array([1, 0, 2]), np.array([1.0, 0, 2]), (np.float64(1), 0, True * 2)
    for given in (*({"space_moment": form} for form in forms), {"body_moment": (0, 0, 0), "space_moment": (1, 0, 2)}):
        loop.state = now
        found.add(loop.step(**given))
    assert len(found) == 1


def test_default_order():
    assert nt.stepper(FREE, H).integrator == LieMidpoint(order=2)
    assert nt.stepper(FREE, H, integrator="energy-momentum").integrator == EnergyMomentum(order=2)
    assert nt.stepper(FREE, H, integrator="gauss").integrator == Gauss(order=2)
    assert nt.stepper(FREE, H, integrator="gauss", order=8).integrator == Gauss(order=8)
    assert nt.stepper(FREE, H, integrator=Gauss()).integrator == Gauss(order=8)


def test_friction_sees_the_time():
    """``J W' = t - 1/2`` while it slides."""
    load = nt.body_moment(lambda t: np.array([t, 0, 0])) + nt.dry_friction(0.5, "x")
    loop = nt.stepper(nt.standard([3, 4, 5]), 0.125, load=load)
    states = [loop.step() for _ in range(16)]
    assert [state.material_angular_velocity[0] for state in states[:4]] == [0.0] * 4
    assert states[-1].material_angular_velocity[0] == pytest.approx(1.5**2 / 2 / 3, rel=1e-13)


def test_wrong_input_keeps_the_state():
    loop = nt.stepper(FREE, H)
    now = loop.reset(**START)
    for call in (
        lambda: loop.step((1, 2)),
        lambda: loop.step(space_moment=np.eye(3)),
        lambda: loop.step((0, np.nan, 0)),
        lambda: loop.step((0, 0, 0), np.array([0, 0, np.inf])),
        lambda: loop.step([0, 0, 1e101]),
        lambda: loop.step("up"),
        lambda: loop.reset(rotation=np.eye(4)),
        lambda: loop.reset(material_angular_velocity=(1, 0, 0), angular_velocity=(1, 0, 0)),
        lambda: loop.reset(time=1e15),
        lambda: setattr(loop, "state", 3),
        lambda: setattr(loop, "state", nt.stepper(FREE, 2 * H).state),
        lambda: setattr(loop, "state", nt.stepper(FREE, H, integrator="gauss").state),
        lambda: setattr(loop, "state", nt.stepper(TOP, H).state),
    ):
        with says():
            call()
        assert loop.state is now


WRONG = [{"step": h} for h in (0, -0.1, np.nan, 1e-150)] + [{"system": "top"}, {"load": (1, 0, 0)}]
WRONG += [{"order": 3}, {"order": 4}]
WRONG += [{"integrator": name} for name in ("lie_midpoint", "split", "exact", "continuous")]
test_arguments_that_stepper_refuses = refused_as(
    {str(given): lambda given=given: nt.stepper(**{"system": FREE, "step": H, **given}) for given in WRONG}
)


@pytest.mark.parametrize(("integrator", "order"), SCHEMES[::2])
def test_failing_step_keeps_the_state(integrator, order):
    h, push = 1 / 16, (60.0, 0.0, 0.0)
    loop = nt.stepper(FREE, h, integrator=integrator, order=order)
    now = loop.reset(**START)
    how = {"t_end": 256 * h, "step": h, "integrator": integrator, "order": order, **START}
    with pytest.raises(SimulationError) as run:
        nt.integrate(FREE, load=constant(push, (0, 0, 0)), **how)
    while loop.time < run.value.time:
        now = loop.step(push)
    with pytest.raises(SimulationError) as failed:
        loop.step(push)
    assert str(failed.value) == str(run.value)
    assert failed.value.step == h
    for name in ("status", "time", "residual"):
        assert getattr(failed.value, name) == pytest.approx(getattr(run.value, name), nan_ok=True)
    assert loop.state is now
    assert now.steps > 10
    other = nt.stepper(FREE, h, integrator=integrator, order=order)
    other.state = now
    assert loop.step((-60, 0, 0)) == other.step((-60, 0, 0))


def late(t, *state):
    if t > 0.5:
        raise ZeroDivisionError("no more")
    return 0.1, 0.0, 0.0


def late_compiled(t, directors, angular_velocity):
    return np.where(t < 0.5, 0.1, np.nan), 0.0, 0.0


FAILING = [(nt.body_moment, late), (nt.moment, late), (compiled_load, late_compiled)]


def test_too_steep_load():
    seen = []
    steep = nt.moment(lambda t, d, w: seen.append([*d.ravel(), *w]) or tuple(1e200 * (1 + w**2)))
    with pytest.raises(SimulationError):
        nt.stepper(FREE, H, load=steep).step()
    assert np.isfinite(seen).all()


@pytest.mark.parametrize(("make", "function"), FAILING)
def test_failing_load_keeps_the_state(make, function):
    loop = nt.stepper(FREE, H, load=make(function))
    with pytest.raises(SimulationError) as failed:
        states(loop)
    assert (failed.value.status, failed.value.time, loop.time) == (Status.LOAD, 0.5, 0.5)
    said(str(failed.value))
    assert f"the load {function.__name__} " in str(failed.value)  # which of them
    if make is not compiled_load:
        assert isinstance(failed.value.__cause__.__cause__, ZeroDivisionError)
    loop.reset()
    with pytest.raises(SimulationError, match="the body turns") as failed:
        loop.step((1e6, 0, 0))
    assert failed.value.status in (Status.TURN, Status.STALLED)
    assert loop.step().time == H


def test_interrupt_in_a_load():
    calls = []

    def interrupting(t, directors, angular_velocity):
        calls.append(t)
        if len(calls) == 3:
            raise SystemExit
        return 0.1, 0.0, 0.0

    loop = nt.stepper(FREE, H, load=nt.moment(interrupting))
    now = loop.state
    with pytest.raises(SystemExit):
        loop.step()
    assert loop.state is now
    assert loop.step().time == H


def test_infinite_work():
    """The load is asked once more for the work, at the velocity of the step, when the iteration is done."""
    asked = []

    def asking(t, directors, w):
        asked.append(w[0])
        return -0.9 * w[0] * abs(w[0]), 0.0, 0.0

    def spoilt(t, directors, w):
        return np.where(w[0] == asked[-1], np.nan, -0.9 * w[0] * abs(w[0])), 0.0, 0.0

    loop = nt.stepper(nt.standard([3, 4, 5]), 0.05, load=nt.moment(asking))
    loop.reset(material_angular_velocity=(1.7, 0, 0))
    loop.step()
    assert asked[-1] not in asked[:-1]
    loop = nt.stepper(nt.standard([3, 4, 5]), 0.05, load=nt.moment(spoilt, compiled=True))
    now = loop.reset(material_angular_velocity=(1.7, 0, 0))
    with pytest.raises(SimulationError, match="step 0 at t = 0 s: the variable load_work is not finite") as failed:
        loop.step()
    assert failed.value.status == Status.NOT_FINITE
    assert loop.state is now


@pytest.mark.parametrize(("scheme", "order"), [("energy-momentum", 2), ("gauss", 4)])
def test_reset_to_a_state(scheme, order):
    """Of its kind: what follows is the same, whatever the scheme carries on beside attitude and velocity."""
    loop = nt.stepper(BODIES["suslov"](), H, load=nt.damping(0.1), integrator=scheme, order=order)
    loop.reset(project=True, **START)
    root, once = states(loop, 5)[-1], states(loop, 7)[-1]
    now = loop.reset(start=root)
    assert (now.time, now.steps, now.load_work, now.reaction_moment) == (root.time, 0, 0, 0)
    again = states(loop, 7)[-1]
    assert (again.quaternion, again.material_angular_velocity) == (once.quaternion, once.material_angular_velocity)


def test_copies():
    """A state that is set again, in the stepper, a copy of it, or another of its kind; these go their own ways."""
    how = {"integrator": "gauss", "order": 4}
    loop = nt.stepper(BODIES["suslov"](), H, load=nt.sine((1, 0, 0), 1) + nt.damping(0.1), **how)
    loop.reset(time=0.3, project=True, **START)
    root = states(loop, 5)[-1]
    copies = [make(loop) for make in (copy.copy, copy.deepcopy, pickled)]
    once = states(loop, 7)
    assert once[-1].steps == 12
    states(loop, 9, (3, 0, 1), (0, 2, 0))
    loop.state = root
    for one in (loop, *copies):
        assert (one.time, one.state) == (root.time, root)
        assert states(one, 7) == once
    assert [make(root) for make in (copy.copy, copy.deepcopy, pickled)] == [root] * 3
    other = nt.stepper(BODIES["suslov"](), H, **how)
    other.state = loop.state = root
    assert other.state == root
    assert other.step() != loop.step()


def pickled(it):
    return pickle.loads(pickle.dumps(it))


def test_repr_of_stepper_and_state():
    loop = nt.stepper(nt.standard([3, 4, 5]), 0.01)
    said(repr(loop))
    assert repr(loop.state) == "<StepperState: t = 0 s, quaternion (0, 0, 0, 1), W (0, 0, 0) rad/s>"
    for name in ("time", "quaternion", "material_angular_velocity"):
        with pytest.raises(AttributeError):
            setattr(loop.state, name, 0)


def test_steppers_in_threads_are_independent():
    """Each thread has its own; the kernels release the interpreter's lock."""

    def driven(seed):
        loop = nt.stepper(TOP, 0.01, integrator="gauss", order=4, load=nt.damping(0.05))
        loop.reset(**START)
        given = np.random.default_rng(seed).normal(size=(200, 2, 3)).tolist()
        return [loop.step(*moments) for moments in given]

    alone = [driven(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(driven, range(4))) == alone


def test_one_step_at_a_time():
    """A load that steps it again, as another thread could, is refused; afterwards it goes on."""
    again = []

    def restless(t, directors, w):
        with pytest.raises(RuntimeError, match="is taking a step: each thread needs one of its own"):
            loop.step()
        again.append(t)
        return 0.0, 0.0, 0.1

    with pytest.warns(UserWarning, match="runs in Python"):
        loop = nt.stepper(FREE, 0.01, load=nt.moment(restless))
    assert loop.step().steps == 1
    assert again
    assert loop.step().steps == 2


def slow(t, z, directors, W):
    return W[2] - z


def weak(t, z, directors, W):
    return 0.0, 0.0, -z


SLOW = nt.memory_load(slow, weak, 0.3, frame="body", compiled=True)
WHEELS = (
    nt.wheel("x", 0.1, 5.0, ([0, 2], [0.1, 0.3]))
    + nt.wheel((0, 3, 4), 0.2, -3.0, viscous=0.02)
    + nt.wheel("z", 0.1, 2.0)
)


@pytest.mark.parametrize("load", [nt.damping(0.1), WHEELS, WHEELS + SLOW])
def test_runs_continue_from_its_states(load):
    """With time, velocity, wheels and memory, as if one run had not ended."""
    how = {"integrator": "gauss", "order": 4, "load": load}
    whole = nt.integrate(FREE, t_end=2, step=H, **START, **how)
    loop, seen = nt.stepper(FREE, H, **how), []
    loop.reset(**START)
    nt.integrate(FREE, t_end=1, step=H, **START, **how, events=lambda t, state: seen.append(state) or 1.0)
    halfway = next(state for state in seen if state.time == 1)
    for state in (states(loop, 64, (0, 0, 0), (0, 0, 0))[-1], halfway):
        run = nt.integrate(FREE, start=state, t_end=2, step=H, **how)
        assert run.time[0] == 1
        np.testing.assert_allclose(run.states.quaternion[-1], whole.states.quaternion[-1], rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.material_angular_velocity[-1], whole.material_angular_velocity[-1], atol=1e-12)
        many = nt.simulate_ensemble(FREE, start=state, t_end=2, step=H, **how)
        np.testing.assert_allclose(many.quaternion[0, -1], whole.states.quaternion[-1], rtol=0, atol=1e-12)
        assert loop.reset(start=state).material_angular_velocity == state.material_angular_velocity
    if load is not WHEELS:
        return
    with pytest.raises(ValueError, match=r"^start= has 9 internal states, of wheels or memory, and the load none$"):
        nt.integrate(FREE, start=loop.state, t_end=2)


def test_torque_of_one_wheel():
    one, same = (nt.stepper(FREE, H, load=nt.wheel("z", 0.1, 2.0)) for _ in range(2))
    assert one.step(wheel_torque=0.2) == same.step(wheel_torque=(0.2,))
    with pytest.raises(ValueError, match=r"^wheel_torque needs wheels, and the load has none: load=wheel\("):
        nt.stepper(FREE, H).step(wheel_torque=0.2)
    with pytest.raises(ValueError, match=r"^wheel_torque needs a number for each wheel, 3, got 1$"):
        nt.stepper(FREE, H, load=WHEELS).step(wheel_torque=0.2)


@pytest.mark.parametrize(("speed", "count"), [(10.4, 0), (10.6, 1)])
def test_coarse_steps_warn_once(speed, count, recwarn):
    """A step of the midpoint rule resolves a turn by up to π/3."""
    body = nt.stepper(nt.standard([3, 4, 5]), 0.1, integrator="lie-midpoint")
    body.reset(material_angular_velocity=(0, 0, speed))
    for _ in range(3):
        body.step()
    assert sum("the step is coarse: the body may turn by" in str(one.message) for one in recwarn.list) == count
