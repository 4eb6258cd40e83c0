"""Wheels with motors: momentum by hand, SciPy, total momentum, continuation, derivatives, what is refused."""

from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import cross, thinned
from nontwist.errors import RunFileError, SimulationError, SimulationInterrupt, Status
from nontwist.runfile.document import checked
from nontwist.runfile.files import Folder
from refusals import refused_as, warned

RPM = 2 * np.pi / 60
J = np.diag([3.0, 4.0, 5.0])
W0 = np.array([0.3, 0.1, 0.35])
AXES, INERTIAS = np.array([[1, 1, 0] / np.sqrt(2), [1, -1, 1] / np.sqrt(3)]), np.array([0.2, 0.3])
KINKS = [1.0, 2.0, 4.0], [0.0, 0.5, -0.3]
SKEW = nt.wheel((1, 1, 0), 0.2, speed=30, torque=0.1) + nt.wheel((1, -1, 1), 0.3, speed=-10, torque=KINKS)
SCHEMES = [("gauss", 2), ("gauss", 8), ("lie-midpoint", 2), ("energy-momentum", 2)]
BODIES = {"standard": nt.standard(J), "suslov": nt.suslov(J + 0.1, (1, 0, 1)), "top": nt.heavy_top(J, 1, (0, 0, 0.5))}


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum", "continuous"])
def test_motor_slows_the_hub_by_its_impulse(scheme):
    """Basilisk's back-of-the-envelope: hub 2 kg m², 0.35 rad/s, motor of 0.2 N m from 5 to 10 s: -0.15 rad/s."""
    inertia = 100 / (6000 * RPM)
    load = nt.wheel("z", inertia, speed=6000 * RPM, torque=([5, 10], [0.2, 0.2]))
    times = {"times": [0, 5, 10]} if scheme == "continuous" else {"t_end": 10, "step": 0.5}
    how = {"angular_velocity": (0, 0, 0.35), "load": load, "integrator": scheme} | times
    run = nt.simulate(nt.standard([2, 2, 2 + inertia]), **how)
    assert run.angular_velocity.values[-1] == pytest.approx([0, 0, -0.15], abs=1e-11)
    assert run.wheel_speed.values[-1, 0] == pytest.approx(6000 * RPM + 0.5 + 1 / inertia, rel=1e-12)
    gained = run.total_kinetic_energy.values[-1] - run.total_kinetic_energy.values[0]
    speed = 6000 * RPM, run.wheel_speed.values[-1, 0]
    near = 1e-7 if scheme == "energy-momentum" else 1e-9  # relative to T: its directors stretch
    assert gained == pytest.approx(0.2 * 5 * (speed[0] + speed[1]) / 2, rel=near)  # torque times what the wheel turns


def test_three_wheels_turn_a_satellite_as_a_published_simulator_finds():
    """Basilisk's test_reactionWheelStateEffector_integrated, BalancedWheels: σ after 1 s; motors give up to 0.2 N m."""
    inertia, load = 100 / (6000 * RPM), nt.Load()
    for axis, speed, torque in (("x", 500, 0.2), ("y", 200, 0.1), ("z", -150, -0.2)):
        load += nt.wheel(axis, inertia, speed=speed * RPM, torque=([0, 0.5], [torque, torque]))
    run = nt.simulate(nt.standard([900, 800, 600]), t_end=1, material_angular_velocity=(0.08, 0.01, 0), load=load)
    assert nt.rotation(run)[-1].as_mrp() == pytest.approx([1.99853994e-2, 2.45647716e-3, 8.45356279e-6], rel=5e-8)


def drag(speed):
    return 0.02 * np.tanh(speed / 3)


def spin_up(t, speed):
    return 0.4 * np.sin(t) - 0.01 * speed


RUBBING = nt.wheel((1, 1, 0), 0.2, 30, 0.1, viscous=0.05) + nt.wheel((1, -1, 1), 0.3, -10, spin_up, friction=drag)


@cache
def reference(*times, rubs=False):
    """Return W, attitude, momenta of the wheels, works of motors and losses by SciPy, as the carrier moves."""
    carrier = J - sum(i * np.outer(n, n) for i, n in zip(INERTIAS, AXES, strict=True))

    def rates(t, y, begin, end):
        W, vector, s, h = y[:3], y[3:6], y[6], y[7:9]
        is_on, speed = KINKS[0][0] <= begin and end <= KINKS[0][-1], h / INERTIAS - AXES @ W
        torque = np.array([0.1, np.interp(t, *KINKS) if is_on else 0.0])
        if rubs:
            torque[1] = spin_up(t, speed[1])
        loss = rubs * np.array([0.05 * speed[0], drag(speed[1])])
        inner = cross(carrier @ W + h @ AXES, W) - (torque - loss) @ AXES
        p = 0.5 * np.append(s * W + cross(vector, W), -vector @ W)
        return np.concatenate([np.linalg.solve(carrier, inner), p, torque - loss, torque * speed, loss * speed])

    y, found = np.concatenate([W0, [0, 0, 0, 1], INERTIAS * ([30, -10] + AXES @ W0), np.zeros(4)]), {}
    for span in pairwise([0.0, 1.0, 2.0, 4.0, 5.0]):
        inner = {t for t in times if span[0] < t <= span[1]}
        how = {"rtol": 1e-13, "atol": 1e-13, "t_eval": sorted({*inner, span[1]}), "args": span}
        run = solve_ivp(rates, span, y, "DOP853", **how)
        found |= dict(zip(run.t.tolist(), run.y.T, strict=True))
        y = run.y[:, -1]
    return np.array([found[t] for t in times])


@pytest.mark.parametrize("rubs", [False, True])
def test_skew_wheels_move_the_body_as_scipy_finds(rubs):
    times = (0.5, 1.5, 3.0, 5.0)
    expected, load = reference(*times, rubs=rubs), RUBBING if rubs else SKEW
    how = {"times": times, "material_angular_velocity": W0, "load": load, "tolerance": 1e-10 if rubs else 1e-11}
    run = nt.simulate(nt.standard(J), **how)
    near = 1e-9 if rubs else 2e-11
    assert run.material_angular_velocity.values == pytest.approx(expected[:, :3], abs=near)
    assert run.wheel_momentum.values == pytest.approx(expected[:, 7:9], abs=1e-9 if rubs else 1e-12)
    assert run.wheel_work.values == pytest.approx(expected[:, 9:11], abs=1e-8 if rubs else 1e-9)
    assert (Rotation.from_quat(expected[:, 3:7]).inv() * nt.rotation(run)).magnitude().max() < near
    if rubs:
        assert run.wheel_loss.values == pytest.approx(expected[:, 11:], abs=1e-8)
        balance = run.total_kinetic_energy - (run.wheel_work - run.wheel_loss).sum("wheel")
        assert np.ptp(balance.values) < 1e-9


@pytest.mark.parametrize(("scheme", "order"), [*SCHEMES, ("gauss", 4)])
def test_order_under_a_torque_that_changes_momentum_and_balances(scheme, order):
    rubs = order == 4
    expected = reference(5.0, rubs=rubs)[0]
    how = {"t_end": 5, "material_angular_velocity": W0, "load": RUBBING if rubs else SKEW}
    runs = [
        nt.simulate(nt.standard(J), step=step, integrator=scheme, order=order, **how)
        for step in {2: (0.05, 0.025), 4: (0.25, 0.125), 8: (0.5, 0.25)}[order]
    ]
    names = {"material_angular_velocity": slice(3), "wheel_work": slice(9, 11)}
    for name, column in [*names.items()][: 1 if rubs else 2]:
        errors = [abs(run[name].values[-1] - expected[column]).max() for run in runs]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3 if rubs else 0.4)
    for run in runs:
        assert nt.drifts(run)["total_momentum"].relative < 1e-14 * len(run.time)
        if not rubs:
            assert np.ptp((run.total_kinetic_energy - run.wheel_work.sum("wheel")).values) < 2e-13
        between = nt.resample(run, [1.5, 3.21], **({} if order == 2 else {"load": how["load"]}))
        assert np.ptp([*between.total_momentum.values, run.total_momentum.values[0]], axis=0).max() < 1e-13


@pytest.mark.parametrize(
    "how", [*({"integrator": name, "order": k} for name, k in SCHEMES), {"integrator": "continuous"}]
)
def test_works_of_motors_do_not_depend_on_what_is_stored(how):
    """Between nodes, without the start, over kinks of the torque, in ensembles, and as continued runs have them."""
    times, body, W = [0.533, 1.707, 3.133, 5.0], nt.standard(J), {"material_angular_velocity": W0}
    own, step, right = {"load": SKEW} | how, {"step": 0.01}, reference(*times)[:, 9:11]
    near = {"abs": {2: 2e-5, 8: 1e-12}.get(how.get("order"), 1e-11)}
    if how["integrator"] == "continuous":
        step = {}

    def until(*times):
        return {"t_end": times[-1]} | step if step else {"times": times}

    def passed(t, state):
        return t - 3.133

    passed.terminal = True
    assert nt.simulate(body, times=times, **step, **own, **W).wheel_work.values == pytest.approx(right, **near)
    first = nt.simulate(body, **until(0, 3), **own, **W)
    assert nt.simulate(body, start=first, **until(3, 5), **own).wheel_work.values[-1] == pytest.approx(
        right[-1], **near
    )
    if step:
        starts = {"material_angular_velocity": [W0, -W0]}
        ends = nt.simulate_ensemble(body, **until(5), variables="all", **own, **starts)
        assert ends.wheel_work.values[0, -1] == pytest.approx(right[-1], **near)
        whole = nt.simulate(body, **until(5), **own, **W)
        assert nt.resample(whole, times).wheel_work.values == pytest.approx(right, **near)
    found = nt.simulate(body, events=passed, **until(0, 5), **own, **W)
    assert found.wheel_work.values[-1] == pytest.approx(right[2], **near)


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
@pytest.mark.parametrize("store", [12, "end"])
def test_an_interrupted_run_ends_with_the_momenta_and_works_of_its_last_state(store):
    """It ends at a node that is no output, and is continued from there."""

    def interrupting(t, directors, w):
        if t > 3.234:
            raise KeyboardInterrupt
        return 0, 0, 0

    how = {"t_end": 5, "step": 0.01, "integrator": "lie-midpoint"}
    start = {"material_angular_velocity": W0}
    whole = nt.simulate(nt.standard(J), load=SKEW, **start, **how)
    with pytest.raises(SimulationInterrupt) as stopped:
        nt.simulate(nt.standard(J), load=SKEW + nt.moment(interrupting), store=store, **start, **how)
    partial = stopped.value.partial
    at = whole.sel(time=partial.time[-1], method="nearest")
    assert partial.time[-1] == pytest.approx(at.time.item(), abs=1e-12)
    found = partial.to_dataset() if hasattr(partial, "to_dataset") else partial
    for name in ("wheel_momentum", "wheel_work", "quaternion"):
        assert found[name].values[-1] == pytest.approx(at[name].values, abs=1e-11)
    rest = nt.simulate(nt.standard(J), start=partial, load=SKEW, **how)
    assert rest.quaternion.values[-1] == pytest.approx(whole.quaternion.values[-1], abs=1e-13)


def test_free_wheel_is_a_rotor_of_constant_momentum_on_its_carrier():
    """Also for `exact`, by theta functions."""
    h = 0.2 * (30 + W0[0])
    own = {"t_end": 6, "material_angular_velocity": W0, "times": np.linspace(0, 6, 13)}
    run = nt.simulate(nt.standard(J), load=nt.wheel("x", 0.2, speed=30), integrator="exact", **own)
    same = nt.simulate(nt.standard(J - np.diag([0.2, 0, 0])), load=nt.rotor("x", h), tolerance=1e-11, **own)
    assert run.directors.values == pytest.approx(same.directors.values, abs=1e-10)
    assert np.ptp(run.total_kinetic_energy.values) < 1e-12


def test_torques_of_a_stepper_add_to_those_of_wheels_with_friction():
    """A factor multiplies the speed at first and the torque, and not friction."""
    table = nt.wheel("z", 0.3, 3, ([0, 1, 1.5], [0, 0.2, 0.4]))
    first, scaled = nt.wheel((1, 1, 0), 0.2, 2, spin_up, viscous=0.03), nt.wheel("y", 0.1, 1, 0.1, friction=drag)
    how = {"step": 0.05, "integrator": "gauss", "order": 4}
    loop = nt.stepper(nt.standard(J), load=nt.damping(0.1) + table + first + 2 * scaled, **how)
    loop.reset(material_angular_velocity=W0)
    kept = [loop.step(wheel_torque=(0.1, -0.2, 0.05)) for _ in range(31)]
    both = nt.wheel("z", 0.3, 3, ([0, 1, 1.5, 3], [0.1, 0.3, 0.5, 0.5]))  # the end of a table is a jump
    own = nt.wheel((1, 1, 0), 0.2, 2, lambda t, speed: spin_up(t, speed) - 0.2, viscous=0.03)
    load = nt.damping(0.1) + both + own + nt.wheel("y", 0.1, 2, 0.25, friction=drag)
    run = nt.simulate(nt.standard(J), t_end=1.5, load=load, material_angular_velocity=W0, **how)
    state = kept[29]
    assert state.material_angular_velocity == pytest.approx(run.material_angular_velocity.values[30], abs=1e-14)
    for name in ("wheel_speed", "wheel_momentum", "wheel_work", "wheel_loss"):
        assert getattr(state, name) == pytest.approx(np.nan_to_num(run[name].values[30]), abs=1e-13)
    loop.state = state
    assert loop.step(wheel_torque=(0.1, -0.2, 0.05)) == kept[30]
    loop.reset(start=run)
    assert loop.state.wheel_work == pytest.approx(run.wheel_work.values[-1], abs=1e-15)


@pytest.mark.filterwarnings("ignore:.*off the grid")
@pytest.mark.parametrize(("body", "scheme"), thinned(4, BODIES, [("gauss", 8), *SCHEMES[2:]]))
def test_derivatives_are_those_of_differences(body, scheme):
    scheme, order = scheme
    how = {"t_start": 1, "t_end": 3, "step": 0.05, "integrator": scheme, "order": order, "project": True}

    def loaded(speed=30.0, torque=0.4, inertia=0.2, axis=AXES[0], values=(1.0, 1.0)):
        gyrostat = 0.5 * nt.wheel((1, -1, 1), 0.3, -10, 0.2) + nt.rotor("y", [1.07, 2.31], values)
        return nt.wheel(axis, inertia, speed=speed, torque=torque) + gyrostat

    def end(W=W0, t_end=3, **changed):
        own = how | {"t_end": t_end, "step": (t_end - 1) / 40}
        run = nt.integrate(BODIES[body], material_angular_velocity=W, load=loaded(**changed), **own)
        return run.material_angular_velocity[-1]

    def slope(name, x, change=1.0, e=1e-5):
        return (end(**{name: x + e * change}) - end(**{name: x - e * change})) / (2 * e)

    wrt = [
        "material_angular_velocity",
        *(f"load[0].{x}" for x in ("speed", "torque", "inertia", "wheel")),
        "duration",
        "values",
    ]
    found = nt.sensitivities(BODIES[body], material_angular_velocity=W0, load=loaded(), wrt=wrt, **how)
    rows = [*(slope("W", W0, v) for v in np.eye(3)), slope("speed", 30.0), slope("torque", 0.4)]
    rows += [(4 * slope("inertia", 0.2) - slope("inertia", 0.2, e=2e-5)) / 3]
    rows += [*(slope("axis", AXES[0], v) for v in np.eye(3)), slope("t_end", 3)]
    rows += [slope("values", np.ones(2), v) for v in np.eye(2)]
    assert pytest.approx(np.array(rows), abs=2e-9) == found.d_material_angular_velocity.values[-1].T


@pytest.mark.parametrize("viscous", [0.0, 0.05])
@pytest.mark.parametrize("times", [[0.5, 2.0], [1.5, 2.0, 2.5]])
def test_a_constant_is_added_to_a_table_within_its_times(times, viscous):
    def run(function, added, **wrt):
        load = 2 * nt.wheel(AXES[0], 0.2, 30, (times, np.full(len(times), 0.3) + added), viscous)
        how = {"t_start": 1, "t_end": 3, "step": 0.05, "material_angular_velocity": W0}
        return function(nt.standard(J), load=load, **how, **wrt)

    found = run(nt.sensitivities, 0.0, wrt="torque").d_material_angular_velocity.values[-1, :, 0]
    ends = [run(nt.integrate, added).material_angular_velocity[-1] for added in (1e-4, -1e-4)]
    assert found == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=1e-8)


def test_exponents_of_a_free_gyrostat_sum_to_zero():
    found = nt.lyapunov(
        nt.standard(J), t_end=6, step=0.1, material_angular_velocity=W0, load=nt.wheel("x", 0.2, speed=30)
    )
    assert float(found.lyapunov_exponent[-1].sum()) == pytest.approx(0, abs=1e-9)


def test_run_file_says_the_same():
    table = {"kind": "wheel", "axis": "z", "inertia": 0.5, "speed": 2, "times": [0, 5], "values": [0.1, 0.1]}
    rubs = {"kind": "wheel", "axis": "z", "inertia": 0.2, "speed": 3, "viscous": 0.1, "coulomb": 0.05}

    def run_of(load, spin=0.2):
        data = {"body": {"kind": "standard", "inertia": [3, 4, 5]}, "time": {"t_end": 8, "step": 0.05}, "load": [load]}
        data["start"] = {"angular_velocity": {"space": [0, 0, spin]}}
        return nt.simulate(checked("wheel.toml", data, Folder(Path())).problem)

    assert run_of(table).angular_velocity.values[-1, 2] == pytest.approx(0.2 - 0.5 / 4.5, abs=1e-12)
    assert run_of(rubs, 0.3).wheel_loss.values[-1, 0] == pytest.approx(0.864, rel=1e-12)  # as it stands at last
    for load, words in (
        (table | {"inertia": 6}, r"load: 1 tables \(the inertia of a body includes that of its wheels"),
        (rubs | {"coulomb": -1}, r"load\.0\.coulomb"),
    ):
        with pytest.raises(RunFileError, match=words):
            run_of(load)


test_what_cannot_be_is_refused = refused_as(
    [
        lambda: nt.wheel("x", 0),
        lambda: nt.wheel("x", 1, torque=[1, 2, 3]),
        lambda: nt.wheel("x", 1, viscous=-1),
        lambda: nt.wheel("x", 1, friction=lambda speed: -speed),
        lambda: nt.simulate(nt.standard(J), t_end=1, load=nt.wheel("x", 3, speed=1)),
        lambda: nt.simulate(nt.nontwisting([3, 4, 5], spin=0.7), t_end=1, load=nt.wheel((1, 0, 1), 0.3, speed=5)),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=SKEW, wrt="duration"),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=SKEW, wrt="load[1].wheel"),
        lambda: nt.sensitivities(nt.nontwisting(J), t_end=1, load=SKEW, wrt="axis"),
        lambda: nt.stepper(nt.standard(J), 0.1, load=SKEW).step(wheel_torque=1),
        lambda: nt.stepper(nt.standard(J), 0.1).step(wheel_torque=[1]),
        lambda: nt.lyapunov(nt.standard(J), t_end=1, load=RUBBING),
        lambda: nt.integrate(nt.standard(J), t_end=1, material_angular_velocity=W0).observables("wheel_speed"),
        lambda: nt.integrate(nt.standard(J), t_end=1, material_angular_velocity=W0).wheel_momentum,
        *(partial(nt.wheel, "z", 0.1, friction=one) for one in (lambda t, speed: speed, lambda: 0.0, 1e-4)),
        partial(nt.wheel, "z", 0.1, torque=lambda t: 1.0),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=RUBBING, wrt="nonsense"),
        lambda: nt.wheel("z", 0.1, torque=0.1, breakpoints=[1]),
    ]
)


def relay(t, directors, w):
    return -np.sign(w[0]), 0.0, 0.0


def test_the_work_of_a_motor_between_steps_is_that_of_its_table_from_the_start_on():
    how = {"t_start": 0.5, "t_end": 1.5, "material_angular_velocity": (0.1, 0.2, 0.3), "order": 8}
    how["load"] = nt.wheel((0, 0, 1), 0.1, speed=3, torque=([0, 1, 2], [0.2, 0.4, -0.1]))
    run = nt.simulate(nt.standard([3, 4, 5]), step=0.02, **how)
    between = nt.resample(run, [0.5, 0.61, 0.83, 1.5])
    at_nodes = nt.simulate(nt.standard([3, 4, 5]), step=0.01, **how).sel(time=between.time, method="nearest")
    assert between.wheel_work.values == pytest.approx(at_nodes.wheel_work.values, abs=1e-9)


@pytest.mark.parametrize("torque", [([0, 1],), ([0, 1], [0, 1], [0, 1]), np.zeros((2, 2))])
def test_a_torque_of_another_form_is_refused(torque):
    with pytest.raises(ValueError, match=r"^torque must be a number, \(times, values\) or a function"):
        nt.wheel((0, 0, 1), 0.1, torque=torque)


def test_the_torque_of_a_motor_that_jumps_at_a_time_is_exact():
    load = nt.wheel("z", 0.1, torque=lambda t, speed: 0.2 * (t > 3.7), breakpoints=[3.7])
    run = nt.simulate(nt.standard(J), t_end=10, load=load)
    assert run.wheel_momentum.values[-1, 0] == pytest.approx(0.2 * 6.3, abs=1e-12)
    with pytest.raises(SimulationError, match="it is called with the time and the speed"):
        nt.simulate(nt.standard(J), t_end=1, load=nt.wheel("z", 0.1, torque=lambda t: 1.0, compiled=False))


JUMPING = {
    "relay": nt.moment(relay, compiled=True) + nt.wheel("x", 0.001, 1),
    "rubbed relay": nt.moment(relay, compiled=True) + nt.wheel("x", 0.001, 1, viscous=0.01),
    "friction": nt.wheel("z", 0.2, 5, friction=lambda speed: 0.1 * np.sign(speed)),
    "motor": nt.wheel("z", 0.2, 5, lambda t, speed: np.where(speed > 3, -0.1, 0.1)),
}


@pytest.mark.parametrize(("name", "how"), thinned(2, JUMPING, [{}, {"step": 0.01}]))
def test_a_jump_beside_or_of_a_wheel_is_named(name, how):
    called, x, y = ("relay", "(1, 0, 0)", "(−1, 0, 0)") if "relay" in name else ("wheel", "(0.1)", "(−0.1)")
    own = {"angular_velocity": (0.5, 0, 0)} | how
    with np.errstate(all="ignore"), pytest.raises(SimulationError, match=f"the load {called} jumps") as failed:
        nt.simulate(BODIES["top"] if "relay" in name else BODIES["standard"], t_end=20, load=JUMPING[name], **own)
    assert failed.value.status == Status.JUMP
    assert all(said in str(failed.value) for said in (x, y, "dry_friction" if "relay" in name else "use coulomb="))


def test_a_run_whose_wheels_do_not_go_on_is_named():
    """Wheels that the load lacks or has otherwise, states that a run has lost, motions without velocities."""
    body, own, W = nt.standard(J), nt.wheel("z", 0.05, speed=100), {"material_angular_velocity": W0}
    push, many = nt.body_moment([0, 1], np.zeros((2, 3))), nt.simulate_ensemble
    for first, second in ((nt.simulate, nt.simulate), (nt.integrate, nt.simulate), (many, many)):
        run = first(body, t_end=1, step=0.5, load=own, **W)
        for load in (None, push, nt.wheel("z", 0.1), nt.wheel("x", 0.05)):
            with warned("start-other-memory"):
                second(body, t_end=2, step=0.5, load=load, start=run)
        with warned():
            second(body, t_end=2, step=0.5, load=own + push, start=run)
    run = nt.simulate(body, t_end=1, load=own, **W)
    with warned("start-other-memory"):
        nt.stepper(body, 0.1).reset(start=run)
    with pytest.raises(ValueError, match="lacks internal_state"):
        nt.simulate(body, t_end=2, load=own, start=run.drop_vars("internal_state"))
    for call in (partial(nt.simulate, body, t_end=2, load=own), nt.stepper(body, 0.1, load=own).reset):
        with warned("start-at-rest"):
            call(start=run.quaternion)
        with warned():
            call(start=run.quaternion, **W)
