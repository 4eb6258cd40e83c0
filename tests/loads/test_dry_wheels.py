"""Wheels with dry friction in their bearings: closed forms, SciPy mode after mode, balances, refusals."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import nontwist as nt
from loads.test_friction import drive
from loads.test_wheels import AXES, BODIES, W0, J, by_scipy
from refusals import refused_as


def swing(t, speed):
    return 0.08 * np.sin(1.3 * t)


def lean(t, speed):
    return 0.12 * np.cos(0.9 * t)


PAIR = nt.wheel(AXES[0], 0.2, 2.0, swing, viscous=0.03, coulomb=0.05) + nt.wheel(
    AXES[1], 0.3, torque=lean, coulomb=0.08
)
ONE = nt.wheel(AXES[0], 0.2, 2.0, viscous=0.03, coulomb=0.05)


def test_wheel_runs_down():
    """Ω' = -(b Ω + c)(1/I + 1/(J - I)) about one axis: Ω = (Ω_0 + c/b) e^{-kt} - c/b until it is zero."""
    inertia, b, c = 0.2, 0.1, 0.05
    k = b * (1 / inertia + 1 / (5 - inertia))
    end = np.log(1 + 3 * b / c) / k
    load = nt.wheel("z", inertia, speed=3, viscous=b, coulomb=c)
    run = nt.simulate(nt.standard(J), t_end=8, step=0.05, load=load, angular_velocity=(0, 0, 0.3))
    t, speed = run.time.values, run.wheel_speed.values[:, 0]
    assert speed == pytest.approx(np.where(t < end, (3 + c / b) * np.exp(-k * t) - c / b, 0), abs=1e-14)
    assert (speed[t > end] == 0).all()
    assert (speed[t < end] > 0).all()
    energy = run.total_kinetic_energy.values
    assert np.diff(energy).max() <= 1e-15
    assert energy[0] - energy[-1] == pytest.approx(run.wheel_loss.values[-1, 0], rel=1e-14)
    assert np.ptp(run.total_momentum.values, axis=0).max() < 1e-13


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_torque_exceeds_the_limit(scheme):
    """From c to -c, which is reached at t = 2.5; then Ω' = -0.02 (t - 2.5)(1/I + 1/(J - I))."""
    load = nt.wheel("z", 0.2, torque=([0, 2.5, 5], [0.05, -0.05, -0.1]), coulomb=0.05)
    run = nt.simulate(nt.standard(J), t_end=5, step=0.1, load=load, integrator=scheme)
    t, k = run.time.values, 1 / 0.2 + 1 / 4.8
    expected = np.where(t > 2.5, -0.01 * (t - 2.5) ** 2 * k, 0)
    assert run.wheel_speed.values[:, 0] == pytest.approx(expected, abs=1e-13)
    for name in ("wheel_speed", "angular_velocity", "wheel_work"):
        assert not run[name].values[t <= 2.5].any()
    assert run.total_kinetic_energy.values == pytest.approx((run.wheel_work - run.wheel_loss).values[:, 0], abs=1e-15)


@pytest.mark.parametrize("rubs", [False, True])
def test_skew_wheels_by_scipy(rubs):
    """Also beside dry friction about two axes of the body."""
    times, load, more = np.linspace(0, 9 if rubs else 6, 16), PAIR, ()
    if rubs:
        about = np.array([[1, 2, 2], [0, 3, 0]]) / 3
        load, more = PAIR + nt.body_moment(drive), (about, [0.8, 0.3], drive)
        load += nt.dry_friction(0.8, about[0]) + 2 * nt.dry_friction(0.15, "y")
    n, how = 2 * rubs, {"material_angular_velocity": W0, "load": load}
    viscous = np.array([0.03, 0])
    expected, modes = by_scipy(times, [2, 0], [swing, lean], lambda speeds: viscous * speeds, [0.05, 0.08], *more)
    for steps in (12, 13):  # so coarse that changes are looked for within them
        coarse = nt.simulate(nt.standard(J), times=times, step=times[-1] / steps, **how)
        assert coarse.material_angular_velocity.values == pytest.approx(expected[:, :3], abs=1e-8)
    run = nt.simulate(nt.standard(J), times=times, step=0.05, **how)
    assert run.material_angular_velocity.values == pytest.approx(expected[:, :3], abs=1e-11)
    assert run.wheel_speed.values == pytest.approx(expected[:, 3:5], abs=1e-11)
    assert run.wheel_work.values == pytest.approx(expected[:, 5:7], abs=1e-11)
    assert run.wheel_loss.values == pytest.approx(expected[:, 7 + n :], abs=1e-11)
    assert ((run.wheel_speed.values == 0) == (abs(expected[:, 3:5]) < 1e-12)).all()
    impulse = np.diff(times)[:, None] * run.moment.values
    assert np.diff(run.spatial_momentum.values, axis=0) == pytest.approx(impulse, abs=1e-13)
    if rubs:
        assert all(0 in k and {-1, 1} & set(k) for k in modes[:, :n].T)
        assert (run.sticking.values == (abs(expected[:, :3] @ about.T) < 1e-12).sum(axis=1)).all()
        assert run.dissipated_energy.values.cumsum() == pytest.approx(expected[1:, 7 : 7 + n].sum(axis=1), abs=1e-11)
    else:
        assert [set(k) for k in modes.T] == [{-1, 0, 1}] * 2
        balance = run.total_kinetic_energy - (run.wheel_work - run.wheel_loss).sum("wheel")
        assert np.ptp(balance.values) < 1e-13
        assert np.ptp(run.total_momentum.values, axis=0).max() < 1e-13
        chosen = nt.simulate(nt.standard(J), times=times, tolerance=1e-9, **how)
        assert chosen.material_angular_velocity.values == pytest.approx(expected[:, :3], abs=1e-8)


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
@pytest.mark.parametrize(("axis", "beside"), [("z", "wheel"), (None, "driven wheel"), (None, "memory")])
def test_body_rests_until_moved(beside, axis, scheme):
    """A ramp of 3 N m a second from 6 s on exceeds the limit 0.3 at 6.1 s."""
    ramp = ([0, 6, 6.5, 12], [0, 0, 1.5, 1.5])
    loads = {
        "wheel": nt.wheel("z", 0.2, torque=ramp, viscous=1e-12),
        "driven wheel": nt.wheel("z", 0.2, torque=ramp),
        "memory": nt.memory_load(ramping, pushing, [0.0], scale=[1.0], frame="body", compiled=True),
    }
    how = {"t_end": 7, "step": 0.05, "angular_velocity": (0, 0, 0.2)}
    how["load"] = nt.dry_friction(0.3, axis) + loads[beside]
    run = nt.simulate(nt.standard(J), integrator=scheme, **how)
    t, spin = run.time.values, run.material_angular_velocity.values[:, 2]
    inertia = 5 if beside == "memory" else 4.8
    moved = np.where(t < 6.5, 1.5 * (t - 6.1) ** 2, 0.24 + 1.2 * (t - 6.5)) / inertia
    stop = 0.2 * inertia / 0.3
    assert (spin[(t > stop) & (t < 6.1)] == 0).all()
    expected = np.where(t < stop, 0.2 - 0.3 / inertia * t, np.where(t > 6.1, -moved, 0))
    assert spin == pytest.approx(expected, abs=2e-8 if axis is None else 1e-12)


def test_statistics():
    body, load = nt.with_gravity(BODIES["suslov"], 1, (0, 0, 0.5)), ONE + nt.dry_friction(0.05, (0.6, 0, 0.8))
    how = {"t_end": 3, "step": 0.05, "load": load, "project": True}
    starts = np.array([W0, -0.5 * W0, 1e5 * W0])
    kinds = ["drift", "extrema", "averages", "total_twist"]
    with pytest.warns(UserWarning, match="^1 of 3 members have failed"):
        many = nt.simulate_ensemble(body, material_angular_velocity=starts, reduce=kinds, **how)
    assert (many.energy_drift.values < 1e-13).tolist() == [True, True, False]
    for member, W in enumerate(starts[:2]):
        run, found = nt.simulate(body, material_angular_velocity=W, **how), many.sel(member=member)
        for name in ("kinetic_energy", "spatial_momentum", "twist_rate", "reaction_moment", "potential_energy"):
            assert found[f"{name}_max"].values == pytest.approx(run[name].values.max(axis=0), abs=1e-12)
            assert found[f"{name}_min"].values == pytest.approx(run[name].values.min(axis=0), abs=1e-12)
        assert found.reaction_moment_mean == pytest.approx(run.reaction_moment.values.mean(), abs=1e-12)
        mean = np.trapezoid(run.kinetic_energy.values, run.time.values) / 3
        assert found.kinetic_energy_mean == pytest.approx(mean, rel=1e-3)
        assert found.kinetic_energy_mean != mean


def test_twist_until_stop():
    start = {"material_angular_velocity": [(0, 0, 1), (0, 0, -0.5)], "reduce": ["total_twist", "averages"]}
    found = nt.simulate_ensemble(nt.standard([3, 4, 5]), t_end=6, step=0.3, load=nt.dry_friction(1.3), **start)
    expected = np.array([1, -0.25]) * 5 / (2 * 1.3)  # W3² / (2 limit / J3): it stops within a step
    assert found.total_twist.values == pytest.approx(expected, abs=1e-12)
    assert found.twist_rate_mean.values == pytest.approx(expected / 6, abs=1e-12)


def bump(t, speed):
    return 0.0501 * np.exp(-(((t - 0.52) / 0.3) ** 2))


@pytest.mark.parametrize("step", [0.5, 0.04])
def test_short_slip_within_a_step(step):
    """The torque exceeds the limit for 27 ms: Ω' = (τ - c)(1/I + 1/(J - I)) until Ω is zero again."""
    run = nt.simulate(nt.standard(J), t_end=2, step=step, load=nt.wheel("z", 0.2, torque=bump, coulomb=0.05))
    begin = 0.52 - 0.3 * np.sqrt(np.log(0.0501 / 0.05))
    k = 1 / 0.2 + 1 / 4.8

    def slope(t, y):
        return [k * (bump(t, 0) - 0.05), 0.05 * y[0]]

    def stops(t, y):
        return y[0] if t > begin + 1e-3 else 1.0

    stops.terminal = True
    slip = solve_ivp(slope, (begin, 1), [0, 0], "DOP853", events=stops, rtol=1e-12, atol=1e-18, max_step=1e-3)
    assert slip.status == 1
    assert run.wheel_loss.values[-1, 0] == pytest.approx(slip.y[1, -1], rel=1e-6)
    assert run.wheel_speed.values[-1, 0] == 0


def test_huge_friction():
    """What is left is the momentum of the locked body; the energy of the slip is lost in 6e-11 s."""
    load = nt.wheel("z", 0.2, speed=3, coulomb=1e10)
    run = nt.simulate(nt.standard(J), t_end=1, load=load, angular_velocity=(0, 0, 0.3))
    assert (run.wheel_speed.values[1:] == 0).all()
    assert run.angular_velocity.values[1:, 2] == pytest.approx((5 * 0.3 + 0.2 * 3) / 5, rel=1e-14)
    energy = run.total_kinetic_energy.values
    assert energy[0] - energy[-1] == pytest.approx(run.wheel_loss.values[-1, 0], rel=1e-14)


def ramping(t, z, directors, w):
    return [np.where((t >= 6) & (t < 6.5), 3.0, 0.0)]


def pushing(t, z, directors, w):
    return [0.0, 0.0, -z[0]]


def fading(t, z, directors, w):
    return [0.5 * w[0] - z[0]]


def remembered(t, z, directors, w):
    return np.array([-0.2 * z[0], 0.1 * z[0] * w[2], 0.0])


def test_with_another_memory_load():
    """λ = -I n·W' of the locked body: a limit above the largest holds the wheel as a part of it, one below does not."""
    beside = nt.memory_load(fading, remembered, [0.3], scale=[1.0], compiled=True)
    how = {"t_end": 4, "step": 0.01, "material_angular_velocity": W0}
    locked = nt.simulate(nt.standard(J), load=beside, **how)
    largest = 0.2 * abs(np.gradient(locked.material_angular_velocity.values[:, 0], 0.01)).max()
    for factor, slips in ((1.001, False), (0.999, True)):
        run = nt.simulate(nt.standard(J), load=nt.wheel("x", 0.2, coulomb=factor * largest) + beside, **how)
        assert run.wheel_speed.values.any() == slips
        if not slips:
            assert run.quaternion.values == pytest.approx(locked.quaternion.values, abs=1e-14)
            memory = run.internal_state.values[:, 3], locked.internal_state.values[:, 0]
            assert memory[0] == pytest.approx(memory[1], abs=1e-14)


test_what_is_refused = refused_as(
    [
        lambda: nt.simulate(nt.standard(J), t_end=1, load=nt.wheel("z", 0.2, coulomb=1) + nt.dry_friction(1)),
        lambda: nt.simulate(nt.standard(J), t_end=1, load=nt.wheel("z", 1, coulomb=1), integrator="energy-momentum"),
    ]
)
