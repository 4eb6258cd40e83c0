"""Bodies with a prescribed spin about the constrained axis."""

import numpy as np
import pytest

import nontwist as nt
from nontwist.analysis.invariants import drifts, twist_defect
from nontwist.integrators import Continuous
from refusals import refused_as, says

TABLE = ([0.5, 1.0, 1.75], [0.4, 3.0, -2.0])
W0 = (1.0, 2.0, 0.0)
SCHEMES = [("gauss", 2), ("gauss", 8), ("lie-midpoint", 2), ("continuous", None)]
pytestmark = pytest.mark.filterwarnings("ignore:.*breakpoint", "ignore:.*rad a step")


def angle(t):
    """The integral of the table from 0 to t."""
    knots = np.unique([0, t, *(s for s in TABLE[0] if s < t)])
    return np.trapezoid(np.interp(knots, *TABLE), knots)


@pytest.mark.parametrize("J", [(3, 4, 5), (3, 5, 4), (4, 5, 3)], ids=["largest", "middle", "smallest"])
@pytest.mark.parametrize(("scheme", "order"), [("gauss", 8), ("continuous", None)])
def test_velocity_in_closed_form(J, scheme, order):
    """J1 W1' = (J2 - J3) c W2 and J2 W2' = (J3 - J1) c W1 are linear, with the angle ∫c as time."""
    body, (a, b) = nt.nontwisting(J, spin=TABLE), ((J[1] - J[2]) / J[0], (J[2] - J[0]) / J[1])
    run = nt.simulate(body, times=[0, 0.8, 2.0, 3.0], material_angular_velocity=W0, integrator=scheme, order=order)
    for t, W in zip(run.time.values, run.material_angular_velocity.values, strict=True):
        root = np.sqrt(complex(a * b))
        phi = root * angle(t)
        C, S = np.cosh(phi), np.sinh(phi) / root
        exact = [C * W0[0] + a * S * W0[1], b * S * W0[0] + C * W0[1], np.interp(t, *TABLE)]
        assert abs(W - np.real(exact)).max() < 2e-11


@pytest.mark.parametrize(("scheme", "order"), SCHEMES)
def test_spin_at_the_nodes(scheme, order):
    """Also with kinks inside of steps."""
    how = {"t_end": 2.1, "step": 0.07, "material_angular_velocity": W0, "integrator": scheme, "order": order}
    run = nt.simulate(nt.nontwisting([3, 4, 5], spin=TABLE), **how)
    bound = 1e-10 if scheme == "continuous" else 1e-14
    assert twist_defect(run) < bound
    form = 10 * run.kinetic_energy.values - np.square(run.spatial_momentum.values).sum(axis=1)
    assert abs(form - form[0]).max() < 10 * bound * abs(form[0])
    assert [one.symbol for one in drifts(run).values()] == ["2J₃K−Π²", "d·d"]
    assert np.ptp(run.kinetic_energy.values) > 1


def test_drive_supplies_the_work():
    """ΔK = A - h μ c of the step, exactly in lie-midpoint, where c is that of its middle."""
    load = nt.pulse((1, 2, 3), 0, 0.7) + nt.damping(0.1) + nt.rotor((1, 1, 1), 2.0)
    body, h = nt.nontwisting([3, 4, 5], spin=TABLE), 0.025
    how = {"t_end": 2, "material_angular_velocity": W0, "load": load}
    run = nt.simulate(body, step=h, integrator="lie-midpoint", **how)
    c = np.interp(run.midtime.values, *TABLE)
    drive = h * run.reaction_moment.values * c
    assert abs(np.diff(run.kinetic_energy.values) - run.load_work.values - drive).max() < 1e-13
    exact = nt.simulate(body, times=run.time.values, integrator="continuous", **how)
    assert abs(run.reaction_moment.values - exact.reaction_moment.values).max() < 2e-2
    fine = nt.simulate(body, step=h, **how)
    assert abs(fine.reaction_moment.values - exact.reaction_moment.values).max() < 1e-9
    assert abs(fine.directors.values - exact.directors.values).max() < 1e-11


def test_zero_spin_same_bits():
    how = {"t_end": 2, "step": 0.05, "material_angular_velocity": W0}
    plain = nt.simulate(nt.nontwisting([3, 4, 5]), **how)
    for zero in (0, 0.0, ([0, 1], [0, 0])):
        body = nt.nontwisting([3, 4, 5], spin=zero)
        assert body.spin is None
        assert nt.simulate(body, **how).quaternion.equals(plain.quaternion)
    beside = nt.simulate_ensemble(nt.DirectorSystem.stack([nt.nontwisting([3, 4, 5], spin=c) for c in (0, 1)]), **how)
    assert abs(beside.material_angular_velocity[0, -1] - plain.material_angular_velocity[-1]).max() < 1e-14


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_members_of_several_spins(scheme):
    rates = np.linspace(-1, 3, 9)
    how = {"t_end": 0.5, "step": 0.05, "integrator": scheme, "material_angular_velocity": W0}
    one = nt.simulate(nt.nontwisting([3, 4, 5], spin=rates[3]), **how)
    E, axis = np.tile(np.diag([3.0, 2, 1]), (9, 1, 1)), np.tile([0.0, 0, 1], (9, 1))
    stack = nt.DirectorSystem.stack([nt.nontwisting([3, 4, 5], spin=c) for c in rates])
    for bodies in (stack, nt.SystemStack(E, axis, spin=1.0, spin_factor=rates)):
        many = nt.simulate_ensemble(bodies, **how)
        assert (many.material_angular_velocity.values[3, -1] == one.material_angular_velocity.values[-1]).all()
        assert (many.spin.values == rates).all()


def test_members_with_own_potentials():
    load, c = nt.dipole((0, 0, 1), (0, 3, 1)), np.array([1.0, 2])
    how = {"t_end": 2, "material_angular_velocity": (1, 0, 0.5), "variables": ("kinetic_energy", "potential_energy")}
    many = nt.simulate_ensemble(nt.nontwisting([3, 3, 3], spin=0.5), load=load, load_scale=c, store=1, **how)
    energy = many.kinetic_energy + many.potential_energy  # the drive of a round body does no work
    assert abs(energy.values - 1.875 + c[:, None]).max() < 1e-9  # ½ 3 (1² + 0.5²) J, less 1 J of the dipole


def test_start_with_the_spin():
    """Or none; another is refused, and with project=True removed."""
    for spin, t_start, c in ((0.7, 0.0, 0.7), (TABLE, 0.75, 1.7)):
        body = nt.nontwisting([3, 4, 5], spin=spin)
        how = {"t_start": t_start, "t_end": 2, "step": 0.125, "integrator": "gauss"}
        starts = [{"material_angular_velocity": (1, 2, x)} for x in (0, c)]
        none, given = (nt.simulate(body, **start, **how) for start in starts)
        assert none.equals(given)
        assert given.material_angular_velocity.values[0] == pytest.approx([1, 2, c], abs=1e-15)
        many = nt.simulate_ensemble(body, material_angular_velocity=[(1, 2, c), (1, 2, 0)], **how)
        assert np.array_equal(*many.material_angular_velocity.values)
        with says():
            nt.simulate(body, material_angular_velocity=(1, 2, 0.5), **how)
        with pytest.raises(ValueError, match=r"of member 1 has the component 0\.5 rad/s"):
            nt.simulate_ensemble(body, material_angular_velocity=[(1, 2, c), (1, 2, 0.5)], **how)
        if not t_start:
            one, other = (nt.sensitivities(body, wrt="spin", **start, **how) for start in starts)
            assert one.equals(other)
            run = nt.propagator(body, t_end=2, step=0.125)
            assert np.array_equal(*(run(**start).directors for start in starts))


def test_continued_start():
    """At the time of the start; an axis that varies turns the velocity that is given, with its part along the axis."""
    body = nt.nontwisting([3, 3, 5], spin=([0, 5, 10], [0, 1, 1]))
    first = nt.simulate(nt.standard([3, 3, 5]), t_end=5, step=0.1, material_angular_velocity=(0, 0, 1))
    run = nt.simulate(body, t_end=6, start=first, step=0.1)
    assert run.material_angular_velocity.values[0] == pytest.approx([0, 0, 1], abs=1e-14)
    with pytest.raises(ValueError, match=r"about which its prescribed spin is 0 rad/s"):
        nt.simulate(body, t_end=6, step=0.1, material_angular_velocity=(0, 0, 1))
    steady, e = nt.nontwisting([4, 4, 4], spin=1.3), 1e-5
    before = nt.simulate(steady, t_end=1, step=0.1, material_angular_velocity=(1, 2, 0))
    how = {"t_end": 2, "step": 0.1, "start": before, "project": True}
    found = nt.sensitivities(steady, wrt="axis", **how).d_material_angular_velocity.values[-1]

    def end(change):
        turned = nt.DirectorSystem(steady.euler_inertia, axis=np.eye(3)[2] + change, spin=1.3, name=steady.name)
        return nt.simulate(turned, **how).material_angular_velocity.values[-1]

    differences = np.stack([(end(e * d) - end(-e * d)) / (2 * e) for d in np.eye(3)], axis=1)
    assert found == pytest.approx(differences, abs=1e-8)


def test_missed_kink_warns():
    with pytest.warns(UserWarning, match=r"of the spin off the grid of step \S+ s, the first at t = 0.5 s: "):
        nt.simulate(nt.nontwisting([3, 4, 5], spin=TABLE), t_end=2.1, step=0.07, material_angular_velocity=W0)


SPUN = nt.nontwisting([3, 4, 5], spin=1)
test_refusals = refused_as(
    [
        lambda: nt.nontwisting([3, 4, 5], spin=([0], [1])),
        lambda: nt.nontwisting([3, 4, 5], spin=([0, 0], [1, 2])),
        lambda: nt.DirectorSystem(np.diag([3.0, 2, 1]), spin=1),
        lambda: nt.DirectorSystem(np.diag([3.0, 2, 1]), axis=(0, 1, 1), spin=1),
        lambda: nt.DirectorSystem.stack([nt.nontwisting([3, 4, 5], spin=([0, 1], [0, c])) for c in (1, 2)]),
        lambda: nt.simulate(SPUN, t_end=1, step=0.1, integrator=Continuous(form="director")),
    ]
)


@pytest.mark.filterwarnings("ignore:damping slows")
def test_newton_under_changing_spin():
    """Where damping is strong, against SciPy on the continuous equations."""
    how = {"t_end": 1, "load": nt.damping(200), "material_angular_velocity": (1, 2, TABLE[1][0])}
    body = nt.nontwisting([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]], spin=TABLE)
    run = nt.simulate(body, step=0.1, order=8, **how)
    exact = nt.simulate(body, integrator="continuous", times=[0, 1], **how)
    assert (nt.rotation(run)[-1].inv() * nt.rotation(exact)[-1]).magnitude() < 1e-5
