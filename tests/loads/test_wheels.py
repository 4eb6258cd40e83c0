"""Wheels with motors: momentum by hand, SciPy, total momentum, continuation, derivatives, what is refused."""

import json
from functools import cache, partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import nontwist as nt
from conftest import cross, or_long, thinned
from nontwist.errors import RunFileError, SimulationError, SimulationInterrupt, Status
from nontwist.runfile import read_run_file
from refusals import refused, refused_as, warned

RPM = 2 * np.pi / 60
J = np.diag([3.0, 4.0, 5.0])
W0 = np.array([0.3, 0.1, 0.35])
AXES, INERTIAS = np.array([[1, 1, 0] / np.sqrt(2), [1, -1, 1] / np.sqrt(3)]), np.array([0.2, 0.3])
KINKS = [1.0, 2.0, 4.0], [0.0, 0.5, 0.0]
SKEW = nt.wheel((1, 1, 0), 0.2, speed=30, torque=0.1) + nt.wheel((1, -1, 1), 0.3, speed=-10, torque=KINKS)
SCHEMES = [("gauss", 8), ("lie-midpoint", 2), ("energy-momentum", 2)]
RUBBED = [("gauss", 4, True), ("lie-midpoint", 2, True), ("energy-momentum", 2, True)]
BODIES = {"standard": nt.standard(J), "suslov": nt.suslov(J + 0.1, (1, 0, 1)), "top": nt.heavy_top(J, 1, (0, 0, 0.5))}


@pytest.mark.parametrize("scheme", ["gauss", "energy-momentum", "continuous"])
def test_motor_slows_the_hub(scheme):
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
    assert run.wheel_work.values[-1, 0] == pytest.approx(gained, rel=near)


def test_three_wheels_of_basilisk():
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


def by_scipy(times, speeds, torques, friction, limits=(0, 0), about=(), most=(), push=lambda t: np.zeros(3)):
    """W, speeds, works and losses of two wheels, beside dry friction about axes of the body, by SciPy's events.

    The unknowns are W and the speeds. A contact that sticks keeps its rate, a row times them, at zero by a force. The
    losses are those about the axes first.
    """
    mass = np.block([[J, INERTIAS * AXES.T], [(INERTIAS * AXES.T).T, np.diag(INERTIAS)]])
    n, rows = len(about), np.vstack([np.hstack([np.reshape(about, (-1, 3)), np.zeros((len(about), 2))]), np.eye(5)[3:]])
    most = np.append(most, limits)

    @cache
    def inverse(is_stuck):
        stuck = rows[list(is_stuck)]
        return np.linalg.inv(np.block([[mass, stuck.T], [stuck, np.zeros((len(stuck), len(stuck)))]]))[:, :5]

    def moments(t, speeds):
        return np.array([torque(t, speed) for torque, speed in zip(torques, speeds, strict=True)]), friction(speeds)

    def rates(t, y, modes):
        W, is_stuck, (torque, loss) = y[:3], modes == 0, moments(t, y[3:5])
        total = J @ W + (INERTIAS * y[3:5]) @ AXES
        right = np.append(cross(total, W) + push(t), torque - loss) - (modes * most) @ rows
        found, held = inverse(tuple(is_stuck)) @ right, np.zeros(len(rows))
        held[is_stuck] = found[5:]
        return found[:5], held

    y, t = np.concatenate([W0, speeds, np.zeros(4 + n)]), 0.0
    modes, found, seen = np.append([int(np.sign(a @ W0)) for a in about], np.where(y[3:5] < 0, -1, 1)), {0.0: y}, []
    while t < times[-1]:
        begin, own = t, modes.copy()

        def ends(t, y, own=own, begin=begin):
            if t < begin + 1e-9:
                return 1.0
            held = rates(t, y, own)[1]
            return min(own[k] * (row @ y[:5]) if own[k] else most[k] - abs(held[k]) for k, row in enumerate(rows))

        def slope(t, y, own=own):
            torque, loss = moments(t, y[3:5])
            lost = (own * most + np.append(np.zeros(n), loss)) * (rows @ y[:5])
            return np.concatenate([rates(t, y, own)[0], torque * y[3:5], lost])

        ends.terminal = True
        until = times[times > t][0]  # as the interpolant is less exact than steps
        part = solve_ivp(slope, (t, until), y, "DOP853", events=ends, rtol=1e-13, atol=1e-14, max_step=0.05)
        t, y = part.t[-1], part.y[:, -1].copy()
        if part.status == 0:
            found[t] = y.copy()
            continue
        held = rates(t, y, own)[1]
        for k, row in enumerate(rows):
            if own[k] and abs(row @ y[:5]) < 1e-9:
                modes[k] = 0
                holds = rates(t, y, modes)[1][k]
                modes[k] = 0 if abs(holds) <= most[k] else np.sign(holds)
            elif not own[k] and most[k] - abs(held[k]) < 1e-9:
                modes[k] = np.sign(held[k])
        seen.append(tuple(modes))
    return np.array([found[x] for x in times]), np.array(seen)


@cache
def reference(*times, rubs=False):
    """Return W, speeds, works and losses of the wheels of `SKEW`, or of `RUBBING`, by SciPy."""
    second, viscous = (spin_up, 0.05) if rubs else (lambda t, speed: np.interp(t, *KINKS), 0.0)
    stops = np.array(sorted({0.0, *times, *KINKS[0]}))
    friction = lambda speeds: np.array([viscous * speeds[0], rubs * drag(speeds[1])])  # noqa: E731
    found, _ = by_scipy(stops, [30, -10], [lambda t, speed: 0.1, second], friction)
    return found[np.searchsorted(stops, times)]


@pytest.mark.parametrize("rubs", [False, True])
def test_skew_wheels_by_scipy(rubs):
    times = (0.5, 1.5, 3.0, 5.0)
    expected, load = reference(*times, rubs=rubs), RUBBING if rubs else SKEW
    how = {"times": times, "material_angular_velocity": W0, "load": load, "tolerance": 1e-10 if rubs else 1e-11}
    run = nt.simulate(nt.standard(J), **how)
    near = 1e-9 if rubs else 2e-11
    assert run.material_angular_velocity.values == pytest.approx(expected[:, :3], abs=near)
    momenta = INERTIAS * (expected[:, 3:5] + expected[:, :3] @ AXES.T)
    assert run.wheel_momentum.values == pytest.approx(momenta, abs=1e-9 if rubs else 1e-12)
    assert run.wheel_work.values == pytest.approx(expected[:, 5:7], abs=1e-8 if rubs else 1e-9)
    assert np.ptp(run.total_momentum.values, axis=0).max() < near
    if rubs:
        assert run.wheel_loss.values == pytest.approx(expected[:, 7:], abs=1e-8)
        balance = run.total_kinetic_energy - (run.wheel_work - run.wheel_loss).sum("wheel")
        assert np.ptp(balance.values) < 1e-9


@pytest.mark.parametrize(
    ("how", "near"),
    [
        ({"integrator": "gauss", "order": 8, "step": 0.01}, 1e-12),
        ({"integrator": "lie-midpoint", "step": 0.01}, 2e-5),
        ({"integrator": "energy-momentum", "step": 0.01}, 2e-5),
        ({"integrator": "continuous"}, 1e-11),
    ],
)
def test_works_of_motors_between_steps(how, near):
    times = 0.533, 1.707, 3.133, 5.0
    run = nt.simulate(nt.standard(J), times=times, load=SKEW, material_angular_velocity=W0, **how)
    assert run.wheel_work.values == pytest.approx(reference(*times)[:, 5:7], abs=near)


@pytest.mark.parametrize(
    ("load", "words"),
    [
        (
            'kind = "wheel", axis = "z", inertia = 6',
            r"load: 1 tables \(the inertia of a body includes that of its wheels",
        ),
        ('kind = "wheel", axis = "z", inertia = 0.2, coulomb = -1', r"load\.0\.coulomb"),
        ('kind = "dry_friction", limit = -1', r"load\.0\.limit"),
        ('kind = "pulse", frame = "body", amplitude = [1, 0, 0], start = 2, end = 1', r"load\.0\.end"),
    ],
)
def test_run_file_errors(load, words, write):
    text = (
        'body = {{ kind = "standard", inertia = [3, 4, 5] }}\ntime = {{ t_end = 1, step = 0.1 }}\nload = [{{ {} }}]\n'
    )
    with pytest.raises(RunFileError, match=words):
        read_run_file(write(text.format(load)))


@pytest.mark.parametrize(("scheme", "order", "rubs"), [*((*one, False) for one in SCHEMES), *RUBBED])
def test_order_under_changing_torque(scheme, order, rubs):
    steps = {2: (0.05, 0.025), 4: (0.25, 0.125), 8: (0.5, 0.25)}[order]
    expected = reference(5.0, rubs=rubs)[0]
    how = {"t_end": 5, "material_angular_velocity": W0, "load": RUBBING if rubs else SKEW}
    runs = [nt.simulate(nt.standard(J), step=step, integrator=scheme, order=order, **how) for step in steps]
    names = {"material_angular_velocity": slice(3), "wheel_work": slice(5, 7), "wheel_loss": slice(7, None)}
    for name, column in [*names.items()][: 1 if order == 4 else 2 + rubs]:
        errors = [abs(run[name].values[-1] - expected[column]).max() for run in runs]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3 if rubs else 0.4)
    run = runs[0]
    assert nt.drifts(run)["total_momentum"].relative < 1e-14 * len(run.time)
    gained = run.wheel_work - np.nan_to_num(run.wheel_loss)
    assert np.ptp((run.total_kinetic_energy - gained.sum("wheel")).values) < 2e-13
    between = nt.resample(run, [1.5, 3.21], **({"load": how["load"]} if rubs or order > 2 else {}))
    assert np.ptp([*between.total_momentum.values, run.total_momentum.values[0]], axis=0).max() < 1e-13


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
def test_interrupted_run():
    """It ends at a node that is no output, and is continued from there."""

    def interrupting(t, directors, w):
        if t > 3.234:
            raise KeyboardInterrupt
        return 0, 0, 0

    how = {"t_end": 5, "step": 0.01, "integrator": "lie-midpoint"}
    start = {"material_angular_velocity": W0}
    whole = nt.simulate(nt.standard(J), load=SKEW, **start, **how)
    with pytest.raises(SimulationInterrupt) as stopped:
        nt.simulate(nt.standard(J), load=SKEW + nt.moment(interrupting), store=12, **start, **how)
    partial = stopped.value.partial
    at, found = whole.sel(time=partial.time[-1], method="nearest"), partial.to_dataset()
    assert partial.time[-1] == pytest.approx(at.time.item(), abs=1e-12)
    for name in ("wheel_momentum", "wheel_work", "quaternion"):
        assert found[name].values[-1] == pytest.approx(at[name].values, abs=1e-11)
    rest = nt.simulate(nt.standard(J), start=partial, load=SKEW, **how)
    assert rest.quaternion.values[-1] == pytest.approx(whole.quaternion.values[-1], abs=1e-13)


def test_free_wheel_is_a_rotor():
    """Also for `exact`, by theta functions."""
    h = 0.2 * (30 + W0[0])
    own = {"t_end": 6, "material_angular_velocity": W0, "times": np.linspace(0, 6, 13)}
    run = nt.simulate(nt.standard(J), load=nt.wheel("x", 0.2, speed=30), integrator="exact", **own)
    same = nt.simulate(nt.standard(J - np.diag([0.2, 0, 0])), load=nt.rotor("x", h), tolerance=1e-11, **own)
    assert run.directors.values == pytest.approx(same.directors.values, abs=1e-10)
    assert np.ptp(run.total_kinetic_energy.values) < 1e-12


@pytest.mark.parametrize(("scheme", "order", "_"), or_long(RUBBED[:2], RUBBED[2:]))
def test_stepper_torques_add(scheme, order, _):
    """A factor multiplies the speed at first and the torque, and not friction."""
    table = nt.wheel("z", 0.3, 3, ([0, 1, 1.5], [0, 0.2, 0.4]))
    first, scaled = nt.wheel((1, 1, 0), 0.2, 2, spin_up, viscous=0.03), nt.wheel("y", 0.1, 1, 0.1, friction=drag)
    how = {"step": 0.05, "integrator": scheme, "order": order}
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


@pytest.mark.filterwarnings("ignore:.*does not resolve")
@pytest.mark.parametrize("b", [0.05, 50])
def test_viscous_wheel_by_midpoint_rule(b):
    """Ω' = -k Ω, k = b (1/I + 1/(J3 - I)), and W across turns at the rate H3/J1 - W3, H3 = (J3 - I) W3 + h."""
    inertia, h, n, (J1, J3) = 0.2, 0.1, np.arange(31), (2.0, 3.0)
    load, W = nt.wheel("z", inertia, 5, viscous=b), (0.3, -0.2, 0.7)
    body, how = nt.standard([J1, J1, J3]), {"material_angular_velocity": W, "t_end": 30 * h}
    run = nt.simulate(body, **how, step=h, load=load, integrator="lie-midpoint")
    k, H = b * (1 / inertia + 1 / (J3 - inertia)), J3 * W[2] + inertia * 5
    speed = 5 * ((2 - k * h) / (2 + k * h)) ** n
    assert run.wheel_speed.values[:, 0] == pytest.approx(speed, abs=5e-14)
    spin = (H - inertia * speed) / J3
    middle = (spin[1:] + spin[:-1]) / 2
    turned = np.append(0, np.cumsum(2 * np.arctan(h / 2 * (H / J1 - middle))))
    across = (W[0] + 1j * W[1]) * np.exp(1j * turned)
    expected = np.column_stack([across.real, across.imag, spin])
    assert run.material_angular_velocity.values == pytest.approx(expected, abs=5e-14)
    lost = (25 - speed**2) / 2 / (1 / inertia + 1 / (J3 - inertia))
    assert run.wheel_loss.values[:, 0] == pytest.approx(lost, abs=5e-14)
    assert np.ptp(run.total_momentum.values, axis=0).max() < 5e-14


@pytest.mark.filterwarnings("ignore:.*off the grid")
@pytest.mark.parametrize(("body", "scheme"), thinned(4, BODIES, SCHEMES))
def test_derivatives_are_those_of_differences(body, scheme):
    scheme, order = scheme
    how = {"t_start": 1, "t_end": 3, "step": 0.05, "integrator": scheme, "order": order, "project": True}

    def loaded(speed=30.0, torque=0.4, inertia=0.2, axis=AXES[0], values=(1.0, 1.0)):
        gyrostat = 0.5 * nt.wheel((1, -1, 1), 0.3, -10, 0.2) + nt.rotor("y", [1.07, 2.31], values)
        return nt.wheel(axis, inertia, speed=speed, torque=torque) + gyrostat

    def end(x):
        own = how | {"t_end": x[9], "step": (x[9] - 1) / 40, "load": loaded(*x[3:6], x[6:9], x[10:])}
        return nt.integrate(BODIES[body], material_angular_velocity=x[:3], **own).material_angular_velocity[-1]

    begin = np.array([*W0, 30.0, 0.4, 0.2, *AXES[0], 3.0, 1.0, 1.0])
    wrt = ["material_angular_velocity", *(f"load[0].{x}" for x in ("speed", "torque", "inertia", "wheel"))]
    wrt += ["duration", "values"]
    found = nt.sensitivities(BODIES[body], material_angular_velocity=W0, load=loaded(), wrt=wrt, **how)
    changes = np.diag([1e-5] * 5 + [2e-6] + [1e-5] * 6)
    rows = [(end(begin + e) - end(begin - e)) / (2 * e.max()) for e in changes]
    assert np.array(rows) == pytest.approx(found.d_material_angular_velocity.values[-1].T, abs=2e-9)


@pytest.mark.parametrize(("times", "viscous"), [([0.5, 2.0], 0.0), ([1.5, 2.0, 2.5], 0.05)])
def test_constant_plus_table(times, viscous):
    def run(function, added, **wrt):
        load = 2 * nt.wheel(AXES[0], 0.2, 30, (times, np.full(len(times), 0.3) + added), viscous)
        how = {"t_start": 1, "t_end": 3, "step": 0.05, "material_angular_velocity": W0}
        return function(nt.standard(J), load=load, **how, **wrt)

    found = run(nt.sensitivities, 0.0, wrt="torque").d_material_angular_velocity.values[-1, :, 0]
    ends = [run(nt.integrate, added).material_angular_velocity[-1] for added in (1e-4, -1e-4)]
    assert found == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=1e-8)


THREE = [nt.standard(J)] * 3
TORQUES = (lambda t: 1.0), [1, 2, 3], ([0, 1],), ([0, 1], [0, 1], [0, 1]), np.zeros((2, 2)), [0.1, 0.2]
test_what_cannot_be_is_refused = refused_as(
    [
        lambda: nt.wheel("x", 0),
        lambda: nt.wheel("x", 1, viscous=-1),
        lambda: nt.wheel("x", 1, friction=lambda speed: -speed),
        lambda: nt.simulate(nt.standard(J), t_end=1, load=nt.wheel("x", 3, speed=1)),
        lambda: nt.simulate(nt.nontwisting([3, 4, 5], spin=0.7), t_end=1, load=nt.wheel((1, 0, 1), 0.3, speed=5)),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=SKEW, wrt="duration"),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=SKEW, wrt="load[1].wheel"),
        lambda: nt.sensitivities(nt.nontwisting(J), t_end=1, load=SKEW, wrt="load[1].values"),
        lambda: nt.sensitivities(nt.nontwisting(J), t_end=1, load=SKEW, wrt="axis"),
        lambda: nt.stepper(nt.standard(J), 0.1, load=SKEW).step(wheel_torque=1),
        lambda: nt.stepper(nt.standard(J), 0.1).step(wheel_torque=[1]),
        lambda: nt.lyapunov(nt.standard(J), t_end=1, load=RUBBING),
        lambda: nt.integrate(nt.standard(J), t_end=1, material_angular_velocity=W0).observables("wheel_speed"),
        lambda: nt.integrate(nt.standard(J), t_end=1, material_angular_velocity=W0).wheel_momentum,
        *(partial(nt.wheel, "z", 0.1, friction=one) for one in (lambda t, speed: speed, lambda: 0.0, 1e-4)),
        *(partial(nt.wheel, "z", 0.1, torque=one) for one in TORQUES),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=RUBBING, wrt="nonsense"),
        lambda: nt.wheel("z", 0.1, torque=0.1, breakpoints=[1]),
    ]
)


EACH = np.array([[0.1, -0.2], [0.0, 0.3], [0.05, 0.0]])


def wheels_with(torques, rubs):
    """Wheels whose motors have these torques beside their own: a number, or a table; or a function of the speed."""
    a, b = np.asarray(torques).tolist()
    if rubs:
        return nt.wheel(AXES[0], 0.2, 30, 0.1 + a, viscous=0.05) + nt.wheel(AXES[1], 0.3, -10, b, coulomb=0.02)
    return nt.wheel(AXES[0], 0.2, 30, a) + nt.wheel(AXES[1], 0.3, -10, ([0.5, 1, 1.5], [b, 0.4 + b, b]))


@pytest.mark.parametrize("rubs", [False, True])
@pytest.mark.parametrize(("body", "scheme"), thinned(4, BODIES, SCHEMES[:2]))
def test_member_torques_equal_runs(body, scheme, rubs):
    """Bit for bit; a factor of the load does not multiply them; total momentum stays; in parts it is one run."""
    scheme, order = scheme
    how = {"step": 0.05, "integrator": scheme, "order": order, "project": True}
    start, more = {"material_angular_velocity": W0, **how}, {"variables": "all", "store": 1}
    load, whole = wheels_with([0.0, 0.0], rubs), wheels_with([0.0, 0.0], False)
    many = nt.simulate_ensemble(BODIES[body], t_end=2, load=load, wheel_torque=EACH, threads=2, **start, **more)
    assert many.wheel_torque.dims == ("member", "wheel")
    assert np.array_equal(many.wheel_torque.values, EACH)
    for i, own in enumerate(EACH):
        one = nt.simulate(BODIES[body], t_end=2, load=wheels_with(own, rubs), **start)
        known = {name for name in many.data_vars if "time" in many[name].dims}
        assert {"wheel_work", "total_momentum", "quaternion", "internal_state"} <= known
        if one.sizes["internal"] < many.sizes["internal"]:  # without a motor
            known.remove("internal_state")
        for name in known:
            assert np.array_equal(many[name].values[i], one[name].values), name
    if body == "standard":
        assert np.ptp(many.total_momentum.values, axis=1).max() < 1e-13
    scaled = nt.simulate_ensemble(
        BODIES[body], t_end=2, load=whole, wheel_torque=EACH, load_scale=[1, 2, 0.5], **start, **more
    )
    one = nt.wheel(AXES[0], 0.2, 60) + nt.wheel(AXES[1], 0.3, -20, ([0.5, 1, 1.5], [0.3, 1.1, 0.3]))
    one = nt.simulate(BODIES[body], t_end=2, load=one, **start)
    assert scaled.wheel_momentum.values[1] == pytest.approx(one.wheel_momentum.values, abs=1e-13)
    first, rest = many.isel(time=slice(21)), {"load": load, "wheel_torque": EACH, "t_end": 2, **how, **more}
    rest = nt.simulate_ensemble(BODIES[body], start=first, **rest)
    for name in ("quaternion", "wheel_speed", "wheel_work"):
        assert rest[name].values[:, -1] == pytest.approx(many[name].values[:, -1], abs=1e-12)
    alone = nt.simulate(BODIES[body], t_end=2, start=first.isel(member=1), load=wheels_with(EACH[1], rubs), **how)
    assert alone.wheel_work.values[-1] == pytest.approx(many.wheel_work.values[1, -1], abs=1e-12)


@pytest.mark.parametrize("rubs", [False, True])
def test_derivatives_of_member_torques(rubs):
    """Also that of a table, to which a constant is added within its times."""
    add = wheels_with([0.0, 0.0], False) if not rubs else nt.wheel(AXES[0], 0.2, 30, 0.1, 0.05) + nt.wheel("z", 0.3)
    how = {"t_end": 2, "step": 0.05, "material_angular_velocity": W0, "load": add}
    found = nt.sensitivities(nt.standard(J), wrt="torque", **how).d_material_angular_velocity.values[-1]
    changes = 1e-4 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    W = nt.simulate_ensemble(nt.standard(J), wheel_torque=changes, **how).material_angular_velocity.values[:, -1]
    differences = (W[::2] - W[1::2]).T / 2e-4
    assert differences == pytest.approx(found, abs=1e-8)


def test_member_torques_elsewhere():
    """One torque for all members is that of the load, and is recorded as such."""
    how = {"t_end": 2, "material_angular_velocity": W0, "load": wheels_with([0.0, 0.0], False)}
    apart, none = {"load": wheels_with(EACH[0], False)}, nt.simulate_ensemble(nt.standard(J), **how)
    alike = nt.simulate_ensemble(nt.standard(J), wheel_torque=EACH[0], **how)
    assert "wheel_torque" not in alike
    records = [nt.simulate_ensemble(nt.standard(J), **how | apart).attrs["load"], alike.attrs["load"]]
    assert [{**one, "has_motor": True} for one in json.loads(records[0])] == json.loads(records[1])
    assert abs(alike.quaternion - none.quaternion).max() > 1e-3
    chosen = nt.simulate_ensemble(nt.standard(J), tolerance=1e-9, wheel_torque=EACH, reduce="drift", **how)
    one = nt.simulate(nt.standard(J), tolerance=1e-11, times=[2], **how | apart)
    assert chosen.quaternion.values[0, -1] == pytest.approx(one.quaternion.values[-1], abs=1e-9)
    assert chosen.energy_drift.values.max() > 0
    how |= {"step": 0.05, "integrator": "lie-midpoint"}
    found = nt.lyapunov_ensemble(nt.standard(J), wheel_torque=EACH, threads=2, **how)
    for i in (0, 2):
        own = nt.lyapunov(nt.standard(J), **how | {"load": wheels_with(EACH[i], False)})
        assert np.array_equal(own.lyapunov_exponent.values[-1], found.lyapunov_exponent.values[i])


@pytest.mark.parametrize(
    ("each", "load", "own"),
    [
        ({"load_scale": [1, 3]}, nt.constant((0.1, 0, 1)), nt.constant((0.3, 0, 3))),
        ({"wheel_torque": EACH}, wheels_with([0.0, 0.0], False), wheels_with(EACH[-1], False)),
        ({"wheel_torque": EACH[1:2]}, wheels_with([0.0, 0.0], False), wheels_with(EACH[1], False)),
    ],
)
def test_resampling_of_members(each, load, own):
    how = {"t_end": 2, "step": 0.1, "material_angular_velocity": W0}
    many = nt.simulate_ensemble(nt.standard(J), load=load, variables="all", store=1, **each, **how)
    found, run = nt.resample(many.isel(member=-1), [0.55, 1.23]), nt.simulate(nt.standard(J), load=own, **how)
    expected = nt.resample(run, [0.55, 1.23])
    for name in {"quaternion", "material_angular_velocity", "total_momentum", "wheel_work"} & {*expected.data_vars}:
        assert found[name].values == pytest.approx(expected[name].values, abs=1e-13), name


@pytest.mark.parametrize(
    ("moments", "load", "more"),
    [
        ([3, 4, 5], nt.wheel("z", 4, torque=2), {}),
        ([3, 4, 5], nt.wheel("z", 4), {"wheel_torque": [[-2.0], [0.0]]}),
        ([3, 4, 5], nt.damping(0.1) + nt.wheel("z", 4), {"wheel_torque": [[-2.0], [0.0]], "load_scale": [1, 0.1]}),
        ([1, 1, 0.05], nt.wheel("x", 0.02, speed=200), {}),
    ],
)
def test_steps_of_members(moments, load, more):
    """A motor turns what carries its wheel, of J - I n nᵀ; the momentum of a wheel turns a slender body to its axis."""
    how = {"t_end": 10, "integrator": "lie-midpoint", "store": 1, **more}
    many = nt.simulate_ensemble(nt.standard(moments), material_angular_velocity=(0, 1.0, 0), load=load, **how)
    speed = np.linalg.norm(many.material_angular_velocity, axis=-1).max()
    assert speed > 3
    assert speed * many.attrs["step"] <= 0.05


@pytest.mark.parametrize(
    ("value", "code", "fields"),
    [
        ([1, 2, 3], "wheel-torque-shape", {"shape": (3,), "count": 2}),
        (0.1, "wheel-torque-shape", {"shape": (), "count": 2}),
        (np.ones((3, 2, 5)), "wheel-torque-shape", {"shape": (3, 2, 5), "count": 2}),
        ([[1, 2], [3, np.nan]], "wheel-torque-not-finite", {"place": [1, 1], "value": "nan"}),
        ([[1, 2], [np.inf, 4]], "wheel-torque-not-finite", {"place": [1, 0], "value": "inf"}),
        (([0, 1], [0.1]), "wheel-torque-type", {}),
        (lambda t: 0.1, "wheel-torque-type", {}),
    ],
)
def test_member_torques_are_numbers(value, code, fields):
    with refused(code, **fields):
        nt.simulate_ensemble(nt.standard(J), t_end=1, load=SKEW, wheel_torque=value)


test_wrong_member_torques = refused_as(
    [
        lambda: nt.simulate_ensemble(nt.standard(J), t_end=1, wheel_torque=[1], load=nt.damping(1)),
        lambda: nt.simulate_ensemble(nt.standard(J), t_end=1, wheel_torque=[1, 2, 3], load=SKEW),
        lambda: nt.simulate_ensemble(nt.standard(J), t_end=1, wheel_torque=[1, np.nan], load=SKEW),
        lambda: nt.simulate_ensemble(nt.standard(J), t_end=1, wheel_torque=[1, "a"], load=SKEW),
        lambda: nt.simulate_ensemble(THREE, t_end=1, wheel_torque=np.ones((2, 2)), load=SKEW),
        lambda: nt.Problem(nt.standard(J), t_end=1, wheel_torque=[1, 2], load=SKEW).forecast(),
    ]
)


def relay(t, directors, w):
    return -np.sign(w[0]), 0.0, 0.0


def test_motor_work_between_steps():
    how = {"t_start": 0.5, "t_end": 1.5, "material_angular_velocity": (0.1, 0.2, 0.3)}
    how["load"] = nt.wheel((0, 0, 1), 0.1, speed=3, torque=([0, 1, 2], [0.2, 0.4, -0.1]))
    between = nt.resample(nt.simulate(nt.standard(J), step=0.02, **how), [0.5, 0.61, 0.83, 1.5])
    at_nodes = nt.simulate(nt.standard(J), step=0.01, **how).sel(time=between.time, method="nearest")
    assert between.wheel_work.values == pytest.approx(at_nodes.wheel_work.values, abs=1e-9)


def test_torque_jump_is_exact():
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


@pytest.mark.parametrize("name", JUMPING)
def test_jump_is_named(name):
    called, x, y, instead = "wheel", "(0.1)", "(−0.1)", "use coulomb="
    if "relay" in name:
        called, x, y, instead = "relay", "(1, 0, 0)", "(−1, 0, 0)", "dry_friction"
    body, how = BODIES["top" if "relay" in name else "standard"], {"step": 0.01} if "rubbed" in name else {}
    with np.errstate(all="ignore"), pytest.raises(SimulationError, match=f"the load {called} jumps") as failed:
        nt.simulate(body, t_end=20, load=JUMPING[name], angular_velocity=(0.5, 0, 0), **how)
    assert failed.value.status == Status.JUMP
    assert all(said in str(failed.value) for said in (x, y, instead))


def test_motor_is_switched_off():
    """Momenta continue, and the states of others, whatever works and losses are known; of joined runs as well."""
    wheel, lag = partial(nt.wheel, "z", 0.05), nt.memory_load(lambda t, z, d, w: w[:1] - z, lambda *_: (0, 0, 0), 0.5)
    runs = [nt.simulate(nt.standard(J), t_end=1, load=wheel(100, 0.2) + lag, material_angular_velocity=W0)]
    for t, own in enumerate([wheel(), wheel(viscous=0.01), wheel(torque=0.1)], start=2):
        runs += [nt.simulate(nt.standard(J), t_end=t, load=own + lag, start=nt.join_runs(*runs))]
        for k in (0, -1):  # h, and the lag
            assert runs[-2].internal_state.values[-1][k] == runs[-1].internal_state.values[0][k]
        assert not {*runs[-1].internal_state.values[0, 1:-1]} - {0.0}
    with warned("start-other-memory"), pytest.raises(ValueError, match="number of wheels, 1, than"):
        nt.simulate(nt.standard(J), t_end=t + 1, load=wheel() + wheel(), start=runs[-1])


@pytest.mark.parametrize("more", [{"viscous": 0.01}, pytest.param({}, marks=pytest.mark.long), {"coulomb": 0.01}])
def test_events_see_wheel_speeds(more):
    load = nt.memory_load(lambda t, z, d, w: -z, lambda *_: (0, 0, 0), 0.5) + nt.wheel((1, 1, 0), 0.2, 3, -0.1, **more)
    how = {"t_end": 5, "load": load, "material_angular_velocity": W0, "step": 0.1}
    run = nt.simulate(nt.standard(J), events=lambda t, state: state.wheel_speed[0] - 2, **how)
    end = nt.simulate(nt.standard(J), **how | {"times": [0, *run.t_events.values]})
    assert end.wheel_speed.values[1:, 0] == pytest.approx([2], abs=1e-9)


def test_wheels_do_not_continue():
    """Wheels that the load lacks or has otherwise, states that a run has lost, motions without velocities."""
    body, own, W = nt.standard(J), nt.wheel("z", 0.05, speed=100), {"material_angular_velocity": W0}
    push, many = nt.body_moment([0, 1], np.zeros((2, 3))), nt.simulate_ensemble
    for first, second in ((nt.integrate, nt.simulate), (many, many)):
        run = first(body, t_end=1, step=0.5, load=own, **W)
        for load in (None, push, nt.wheel("z", 0.1), nt.wheel("x", 0.05)):
            with warned("start-other-memory"):
                second(body, t_end=2, step=0.5, load=load, start=run)
        with warned():
            second(body, t_end=2, step=0.5, load=own + push, start=run)
    run = nt.simulate(body, t_end=1, load=own, **W)
    with warned("start-other-memory"):
        nt.stepper(body, 0.1).reset(start=run)
    state, other = (nt.stepper(body, 0.1, load=nt.wheel(n, 0.05, speed=100)).state for n in "zx")
    for load in (None, own + own, nt.wheel("z", 0.1), nt.wheel("x", 0.05)):
        loop = nt.stepper(body, 0.1, load=load)
        with pytest.raises(ValueError, match="axis, wheels or memory; use reset"):
            loop.state = state
    with warned("start-other-memory"):
        loop.reset(start=state)
    with warned():
        loop.reset(start=other)
    loop.state = other
    with pytest.raises(ValueError, match="lacks internal_state"):
        nt.simulate(body, t_end=2, load=own, start=run.drop_vars("internal_state"))
    for call in (partial(nt.simulate, body, t_end=2, load=own), nt.stepper(body, 0.1, load=own).reset):
        with warned("start-at-rest"):
            call(start=run.quaternion)
        with warned():
            call(start=run.quaternion, **W)


def test_friction_gaining_energy():
    """Between 3.3 and 5.55 rad/s, or 4.99 and 5.01, where nobody looks before: wheel_loss would fall."""
    with pytest.raises(ValueError, match="must slow the wheel down, but at 3"):
        nt.wheel("z", 1, speed=5.2, friction=lambda speed: 2 * speed * (speed - 5.55) * (speed - 3.3))
    load = nt.wheel("z", 1, speed=5.003, friction=lambda speed: 2 * speed * ((speed - 5) ** 2 - 1e-4))
    body, how = nt.standard([3, 4, 5]), {"t_end": 3, "step": 0.01, "load": load}
    for choice in ({}, {"store": "end"}, {"integrator": "lie-midpoint"}):
        with pytest.raises(SimulationError, match=r"must slow the wheel down, but at 5\.00") as caught:
            nt.simulate(body, **how | choice)
        assert caught.value.status == Status.LOAD
    with pytest.warns(UserWarning, match="2 of 2 members have failed"):
        many = nt.simulate_ensemble(body, **how, material_angular_velocity=[(0, 0, 0), (0, 0, 1)])
    assert (many.status == Status.LOAD).all()
    slower = nt.wheel("z", 1, speed=4.9, friction=lambda speed: 2 * speed * ((speed - 5) ** 2 - 1e-4))
    assert np.diff(nt.simulate(body, **how | {"load": slower}).wheel_loss.values[:, 0]).min() >= 0


def test_saturated_motor_from_rest():
    """The errors of speed and work count relative to what a wheel reaches, not to 1 rad/s, with which it did not start.

    The torque is at its limit until the speed is near its goal; then what is left decays.
    """
    J, inertia, limit, gain, goal = 1e-3, 1.2e-6, 1e-5, 2e-7, 673.0

    def motor(t, speed):
        return np.clip(gain * (goal - speed), -limit, limit)

    t, rate = np.linspace(0, 200, 41), 1 / inertia + 1 / (J - inertia)
    begin = (goal - limit / gain) / (limit * rate)
    left = limit / gain * np.exp(-gain * rate * np.maximum(t - begin, 0))
    load = nt.wheel("z", inertia=inertia, torque=motor)
    run = nt.simulate(nt.standard([2e-3, 2e-3, J]), times=t, load=load, tolerance=1e-5)
    assert run.wheel_speed.values[:, 0] == pytest.approx(np.where(t < begin, limit * rate * t, goal - left), rel=1e-5)
    assert 200 / run.step < 10_000
