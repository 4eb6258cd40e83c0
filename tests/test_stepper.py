"""The stepper: the bits of a run, balances, failures that leave the state alone, branches, copies, threads."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, compiled_load
from nontwist.errors import SimulationError, Status
from nontwist.integrators import INTEGRATORS, EnergyMomentum, Gauss, LieMidpoint
from refusals import said, says

H, N = 1 / 64, 64  # so that t_end / N is the step, and all nodes are the same floats
M, m = (9.0, -4.0, 7.0), (3.0, 5.0, -2.0)
START = {"rotation": Rotation.from_rotvec([0.4, -0.3, 0.8]), "material_angular_velocity": (1.1, -0.7, 0.4)}
SCHEMES = [("lie-midpoint", 2), ("gauss", 2), ("gauss", 4), ("gauss", 8), ("energy-momentum", 2)]
FREE = nt.standard([[3.1, 0.2, -0.3], [0.2, 4.2, 0.1], [-0.3, 0.1, 5.5]])
TOP = nt.heavy_top([2, 2, 0.5], mass=1.5, centre_of_mass=[0, 0, 0.6])

every_scheme = pytest.mark.parametrize(("integrator", "order"), SCHEMES)


def constant(body, space):
    return nt.body_moment(lambda t: body) + nt.space_moment(lambda t: space)


def states(loop, count=N, body=M, space=m):
    return [loop.step(body, space) for _ in range(count)]


def bits(array):
    return [tuple(row) for row in array.values[0].tolist()]


def require_same_bits(found, run):
    """The stepper's states are those of an ensemble of one."""
    assert [state.time for state in found] == run.time.values.tolist()
    assert [state.quaternion for state in found] == bits(run.quaternion)
    assert [state.material_angular_velocity for state in found] == bits(run.material_angular_velocity)


@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("body", BODIES)
def test_states_work_and_reaction_have_the_bits_of_a_run(body, order):
    """Those of the other integrators are in the table of promises."""
    system, how = BODIES[body](), {"integrator": "gauss", "order": order}
    run = nt.integrate(system, t_end=H * N, step=H, load=constant(M, m), project=True, **START, **how)
    loop = nt.stepper(system, H, **how)
    loop.reset(project=True, **START)
    found = states(loop)
    for name in ("quaternion", "material_angular_velocity"):  # a run keeps the attitude, not the sign
        states_of_it = np.array([getattr(state, name) for state in found])
        assert np.array_equal(abs(states_of_it), abs(getattr(run, name)[1:]))
    assert [state.load_work for state in found] == run.load_work.tolist()
    reaction = np.zeros(N) if system.axis is None else -run.multipliers[:, -1]
    assert [state.reaction_moment for state in found] == reaction.tolist()
    assert loop.rotation.as_matrix() == pytest.approx(run.directors[-1].T, abs=1e-15)


def drag(t, directors, w):
    return -0.1 * t * w[0] * abs(w[0]), 0.2 * directors[2][1], -0.1 * w[2]


BESIDES = {
    "time": lambda: nt.sine((1, 2, 0), 0.7) + nt.sine((0, 1, 0), 1.3, frame="space") + nt.damping([0.1, 0.2, 0.3]),
    "compiled": lambda: compiled_load(drag),
    "Python": lambda: nt.moment(drag),
}


@every_scheme
@pytest.mark.parametrize("kind", BESIDES)
def test_a_load_acts_besides(integrator, order, kind):
    load = BESIDES[kind]()
    loop = nt.stepper(FREE, H, integrator=integrator, order=order, load=load)
    how = {"t_end": H * N, "step": H, "integrator": integrator, "order": order, "store": 1}
    require_same_bits([loop.state, *states(loop)], nt.simulate_ensemble(FREE, load=load + constant(M, m), **how))


@every_scheme
@pytest.mark.parametrize("body", ["standard", "suslov"])
@pytest.mark.parametrize("first", [nt.simulate, nt.integrate])
def test_it_continues_a_run_with_its_bits(body, integrator, order, first):
    system, how = BODIES[body](), {"integrator": integrator, "order": order}
    how |= {"step": H, "load": constant(M, m)}
    whole = nt.simulate_ensemble(system, t_end=2 * H * N, store=1, **how)
    loop = nt.stepper(system, H, integrator=integrator, order=order)
    before = loop.reset(start=first(system, t_end=H * N, **how))
    assert before.time == H * N
    sign = np.sign(np.dot(before.quaternion, whole.quaternion.values[0, N]))  # a run keeps the attitude, not the sign
    found = states(loop)
    require_same_bits(found, whole.isel(time=slice(N + 1, None)).assign(quaternion=sign * whole.quaternion[:, N + 1 :]))


@every_scheme
def test_the_quaternion_does_not_jump_where_a_run_of_more_than_a_turn_is_continued(integrator, order):
    how = {"integrator": integrator, "order": order}
    run = nt.integrate(FREE, t_end=9, step=H, material_angular_velocity=(1, 0, 0), **how)
    loop = nt.stepper(FREE, H, **how)
    before = loop.reset(start=run)
    assert np.dot(before.quaternion, loop.step().quaternion) > 0.99


def test_a_moment_in_space_stands_still_on_an_orbit():
    """The run of the same moments by DOP853: without them, `gauss` sees the body from the orbit."""
    load, moment, start = nt.gravity_gradient(0.6), (0.3, 0.5, -0.2), {"angular_velocity": (0.9, -1.3, 0.6)}
    loop = nt.stepper(nt.standard([3, 4, 5]), 0.125, integrator=Gauss(order=8), load=load)
    loop.reset(**start)
    for _ in range(12):
        state = loop.step(space_moment=moment)
    load = load + nt.space_moment(lambda t: moment)
    run = nt.integrate(nt.standard([3, 4, 5]), times=[0, 1.5], integrator="continuous", load=load, **start)
    np.testing.assert_allclose(state.material_angular_velocity, run.material_angular_velocity[-1], atol=1e-11)


def test_the_constraint_bears_the_moment_about_its_axis():
    loop = nt.stepper(nt.nontwisting([3, 4, 5]), 0.01)
    assert loop.state.reaction_moment == 0
    state = loop.step(body_moment=(0, 0, 2))
    assert state.reaction_moment == pytest.approx(-2)
    assert (state.material_angular_velocity, state.load_work) == ((0, 0, 0), 0)


def test_the_angular_velocity_in_space_is_that_of_the_body_turned():
    state = nt.stepper(FREE, H).reset(**START)
    turned = START["rotation"].apply(START["material_angular_velocity"])
    assert state.angular_velocity == pytest.approx(turned, abs=1e-15)
    w = nt.stepper(FREE, H).reset(rotation=START["rotation"], angular_velocity=turned).material_angular_velocity
    assert w == pytest.approx(START["material_angular_velocity"], abs=1e-15)


def test_it_starts_at_rest_at_the_identity_and_again():
    loop = nt.stepper(FREE, H)
    first = loop.state
    assert (loop.time, first.steps, first.load_work) == (0, 0, 0)
    assert loop.material_angular_velocity == (0, 0, 0)
    assert loop.rotation.magnitude() == 0
    states(loop, 3)
    assert (loop.state.steps, loop.state != first) == (3, True)
    assert loop.reset() == first
    assert hash(loop.state) == hash(first)


def test_time_is_counted_and_not_added_up():
    loop = nt.stepper(FREE, 0.1)
    loop.reset(time=3.7)
    assert [loop.step().time for _ in range(1000)] == [3.7 + k * 0.1 for k in range(1, 1001)]


def test_every_form_of_a_moment_is_the_same():
    loop = nt.stepper(FREE, H)
    now, found = loop.reset(**START), set()
    for given in ((1, 0, 2), [1.0, 0.0, 2.0], np.array([1, 0, 2]), np.array([1.0, 0, 2]), (np.float64(1), 0, True * 2)):
        loop.state = now
        found.add(loop.step(space_moment=given))
    loop.state = now
    found.add(loop.step((0, 0, 0), (1, 0, 2)))
    assert len(found) == 1


def test_the_order_is_2_unless_another_is_asked_for():
    assert nt.stepper(FREE, H).integrator == LieMidpoint(order=2)
    assert nt.stepper(FREE, H, integrator="energy-momentum").integrator == EnergyMomentum(order=2)
    assert nt.stepper(FREE, H, integrator="gauss").integrator == Gauss(order=2)
    assert nt.stepper(FREE, H, integrator="gauss", order=8).integrator == Gauss(order=8)
    assert nt.stepper(FREE, H, integrator=Gauss()).integrator == Gauss(order=8)


@pytest.mark.parametrize(
    "call",
    [
        lambda s: s.step((1, 2)),
        lambda s: s.step(space_moment=np.eye(3)),
        lambda s: s.step((0, np.nan, 0)),
        lambda s: s.step((0, 0, 0), np.array([0, 0, np.inf])),
        lambda s: s.step([0, 0, 1e101]),
        lambda s: s.step("up"),
        lambda s: s.reset(rotation=np.eye(4)),
        lambda s: s.reset(material_angular_velocity=(1, 0, 0), angular_velocity=(1, 0, 0)),
        lambda s: s.reset(time=1e15),
        lambda s: setattr(s, "state", 3),
        lambda s: setattr(s, "state", nt.stepper(FREE, 2 * H).state),
    ],
)
def test_wrong_input_is_refused_and_leaves_the_state(call):
    loop = nt.stepper(FREE, H)
    now = loop.reset(**START)
    with says():
        call(loop)
    assert loop.state is now


@pytest.mark.parametrize(
    "given",
    [
        {"step": 0},
        {"step": -0.1},
        {"step": np.nan},
        {"step": 1e-150},
        {"system": "top"},
        {"load": (1, 0, 0)},
        {"order": 3},
        {"order": 4},
        {"integrator": "split"},
        {"integrator": "lie_midpoint"},
    ],
)
def test_arguments_that_stepper_refuses(given):
    with says():
        nt.stepper(**{"system": FREE, "step": H, **given})


@pytest.mark.parametrize("integrator", [name for name in INTEGRATORS if name not in dict(SCHEMES)])
def test_integrators_without_a_compiled_step_are_refused(integrator):
    with pytest.raises(ValueError, match=f"gauss, lie-midpoint and energy-momentum, got {integrator}$"):
        nt.stepper(FREE, H, integrator=integrator)


def test_a_spin_about_the_constrained_axis_is_refused_or_removed():
    loop = nt.stepper(nt.nontwisting([3, 4, 5]), H)
    with pytest.raises(ValueError, match="project=True removes it"):
        loop.reset(material_angular_velocity=(1, 0, 1))
    assert loop.reset(material_angular_velocity=(1, 0, 1), project=True).material_angular_velocity == (1, 0, 0)


@every_scheme
def test_a_step_that_fails_says_what_a_run_says_and_leaves_the_state(integrator, order):
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


@pytest.mark.parametrize(("make", "function"), FAILING)
def test_a_load_that_fails_says_what_a_run_says_and_leaves_the_state(make, function):
    load = make(function)
    loop = nt.stepper(FREE, H, load=load)
    with pytest.raises(SimulationError) as failed:
        states(loop)
    assert (failed.value.status, failed.value.time, loop.time) == (Status.LOAD, 0.5, 0.5)
    said(str(failed.value))
    loop.reset()
    with pytest.raises(SimulationError, match="the body turns") as failed:
        loop.step((1e6, 0, 0))
    assert failed.value.status in (Status.TURN, Status.STALLED)
    assert loop.step().time == H


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_in_a_load_passes_and_keeps_the_state(stop):
    calls = []

    def interrupting(t, directors, angular_velocity):
        calls.append(t)
        if len(calls) == 3:
            raise stop
        return 0.1, 0.0, 0.0

    loop = nt.stepper(FREE, H, load=nt.moment(interrupting))
    now = loop.state
    with pytest.raises(stop):
        loop.step()
    assert loop.state is now
    assert loop.step().time == H


def test_a_work_that_is_not_finite_is_no_state():
    """The load is asked once more for the work, at the velocity of the step, when the iteration is done."""
    asked = []

    def drag(t, directors, w):
        asked.append(w[0])
        return -0.9 * w[0] * abs(w[0]), 0.0, 0.0

    loop = nt.stepper(nt.standard([3, 4, 5]), 0.05, load=nt.moment(drag))
    loop.reset(material_angular_velocity=(1.7, 0, 0))
    loop.step()
    last = asked[-1]
    assert last not in asked[:-1]

    def spoilt(t, directors, w):
        return np.where(w[0] == last, np.nan, -0.9 * w[0] * abs(w[0])), 0.0, 0.0

    loop = nt.stepper(nt.standard([3, 4, 5]), 0.05, load=nt.moment(spoilt, compiled=True))
    now = loop.reset(material_angular_velocity=(1.7, 0, 0))
    with pytest.raises(SimulationError, match="step 0 at t = 0 s: the variable load_work is not finite") as failed:
        loop.step()
    assert failed.value.status == Status.NOT_FINITE
    assert loop.state is now


@every_scheme
def test_a_state_that_is_set_again_leads_where_it_led(integrator, order):
    loop = nt.stepper(TOP, H, integrator=integrator, order=order, load=nt.damping(0.1))
    loop.reset(time=0.3, **START)
    root = states(loop, 5)[-1]
    once = states(loop, 7)
    states(loop, 9, (3, 0, 1), (0, 2, 0))
    loop.state = root
    assert (loop.time, loop.state) == (root.time, root)
    assert states(loop, 7) == once
    assert once[-1].steps == 12


def test_a_state_is_taken_by_another_stepper_of_its_kind():
    one, other = nt.stepper(FREE, H, load=nt.damping(0.1)), nt.stepper(FREE, H)
    one.reset(**START)
    other.state = states(one, 3)[-1]
    assert other.state == one.state
    assert other.step() != one.step()
    for stranger in (
        nt.stepper(FREE, H, integrator="gauss"),
        nt.stepper(FREE, H, integrator="energy-momentum"),
        nt.stepper(TOP, H),
    ):
        with pytest.raises(ValueError, match="state belongs to a stepper with another integrator, order, step"):
            stranger.state = one.state


@every_scheme
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
def test_a_copy_goes_its_own_way_from_the_same_state(integrator, order, duplicate):
    loop = nt.stepper(
        BODIES["suslov"](), H, integrator=integrator, order=order, load=nt.sine((1, 0, 0), 1) + nt.damping(0.1)
    )
    loop.reset(project=True, **START)
    states(loop, 5)
    other = duplicate(loop)
    assert other.state == loop.state
    assert duplicate(loop.state) == loop.state
    found = states(loop, 5)
    assert other.time == 5 * H
    assert states(other, 5) == found


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
        given = np.random.default_rng(seed).normal(size=(400, 2, 3)).tolist()
        return [loop.step(*moments) for moments in given]

    alone = [driven(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(driven, range(4))) == alone


def test_a_controller_with_memory_brings_the_body_to_a_halt_where_it_should():
    """Proportional, integral and derivative terms against a constant moment that the controller does not know."""
    target, memory = Rotation.from_rotvec([0.3, -0.8, 0.5]), np.zeros(3)
    loop = nt.stepper(FREE, 0.05, load=nt.space_moment(lambda t: (0.2, -0.1, 0.3)))
    state = loop.state
    for _ in range(4000):
        error = (target.inv() * state.rotation).as_rotvec()
        memory += 0.05 * error
        state = loop.step(-4 * error - 0.4 * memory - 8 * np.array(state.material_angular_velocity))
    assert (target.inv() * state.rotation).magnitude() < 1e-9
    assert state.rotation.apply(-0.4 * memory) == pytest.approx([-0.2, 0.1, -0.3], abs=1e-9)
