"""Dissipation of energy with the momentum kept, as an option of the two midpoint schemes."""

from itertools import product

import numpy as np
import pytest

import nontwist as nt
from conftest import NONTWISTING, STANDARD
from nontwist.analysis.invariants import drifts
from nontwist.integrators import EnergyMomentum, LieMidpoint
from nontwist.integrators.energy_momentum import gain
from nontwist.sweeps import sweep
from refusals import refused_as

J = np.array([[3, 0.2, 0.1], [0.2, 4, -0.3], [0.1, -0.3, 5.0]])
MIDDLE = (0.1, 2.0, 0.1)
SCHEMES = [LieMidpoint, EnergyMomentum]
pytestmark = pytest.mark.filterwarnings("ignore:.*rad a step", "ignore:.*runs in Python")


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("order", [1, 2])
def test_energy_falls_momentum_stays(scheme, order):
    """Rotation ends about the axis of the largest moment, where K is the least for its momentum."""
    for step, t_end, chi in ((0.02, 80, 0.8), (0.8, 80, 0.8), (0.2, 2000, 1)):
        how = {"t_end": t_end, "step": step, "integrator": scheme(order, dissipation=chi)}
        run = nt.simulate(nt.standard(J), material_angular_velocity=MIDDLE, **how)
        K, pi = run.kinetic_energy.values, run.spatial_momentum.values
        least = pi[0] @ pi[0] / (2 * np.linalg.eigvalsh(J)[-1])
        assert np.diff(K).max() <= 1e-14 * K[0]
        assert K[-1] < K[0] - 1e-3
        assert K.min() >= least * (1 - 1e-13)
        assert abs(pi - pi[0]).max() < (1e-12 if t_end > 80 else 3e-13)
    if order == 1:
        assert K[-1] < least * (1 + 1e-3)


LOAD = nt.pulse((1, 2, 3), 0, 0.7) + nt.damping(0.1) + nt.pulse((0, 2, 1), 0, 1, frame="space")


@pytest.mark.parametrize("load", [None, LOAD])
def test_energy_momentum_loss(load):
    """ΔK less the work is -χ/2 Σ E_i (Δ|d_i'|)²."""
    chi, E = 0.6, np.array([3, 2, 1])
    top, how = nt.heavy_top([3, 4, 5], 1.5, (0.1, 0, 0.6)), {"material_angular_velocity": MIDDLE, "load": load}
    run = nt.simulate(top, t_end=2, step=0.05, integrator=EnergyMomentum(1, dissipation=chi), **how)
    length = np.linalg.norm(run.director_velocities.values, axis=2)
    lost = -chi / 2 * np.square(np.diff(length, axis=0)) @ E
    energy = (run.kinetic_energy + run.potential_energy).values
    assert abs(np.diff(energy) - run.load_work.values - lost).max() < 1e-13
    assert abs(lost).max() > 1e-5


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("load", [None, LOAD + nt.moment(lambda t, d, w: (0, t * d[0, 1], -w[2]))])
def test_lie_midpoint_loss(load, order):
    """Δ(K + V) less the work is -g (Q × W_m)·ΔP, with the impulse of the load as it is."""
    h, chi = 0.05, 0.6
    how = {"t_end": 2, "step": h, "material_angular_velocity": MIDDLE, "load": load}
    run = nt.simulate(STANDARD, integrator=LieMidpoint(order, dissipation=chi), **how)
    W = run.material_angular_velocity.values
    middle, dP = (W[1:] + W[:-1]) / 2, np.diff(W, axis=0) * [3, 4, 5]
    g = chi * h / 12 * (1 if order == 1 else h * np.linalg.norm(middle, axis=1))
    lost = -g * (np.cross(middle * [3, 4, 5], middle) * dP).sum(axis=1)
    bound = 3e-14 if load is None else 1e-13
    assert abs(np.diff(run.kinetic_energy.values) - run.load_work.values - lost).max() < bound
    assert abs(np.diff(run.spatial_momentum.values, axis=0) - h * run.moment.values).max() < 1e-13


@pytest.mark.parametrize("scheme", SCHEMES)
def test_no_dissipation_same_bits(scheme):
    """But for that of a permanent rotation, which keeps its bits."""
    how = {"t_end": 4, "step": 0.1, "material_angular_velocity": MIDDLE}
    schemes = scheme(), scheme(dissipation=0), scheme(dissipation=0.5)
    plain, zero, run = (nt.simulate(nt.standard(J), integrator=one, **how) for one in schemes)
    assert (plain.quaternion.values == zero.quaternion.values).all()
    assert [one.symbol for one in drifts(run).values()] == ["π", "d·d"]
    assert max(one.relative for one in drifts(run).values()) < 1e-14
    for order, W in product((1, 2), 2.0 * np.eye(3)):
        how |= {"integrator": scheme(order, dissipation=1), "material_angular_velocity": W}
        assert (nt.simulate(STANDARD, **how).material_angular_velocity.values == W).all()


test_what_is_refused = refused_as(
    [
        lambda: LieMidpoint(dissipation=1.5),
        lambda: LieMidpoint(dissipation=-0.1),
        lambda: LieMidpoint(order=1),
        lambda: LieMidpoint(order=3, dissipation=0.1),
        *(
            lambda scheme=scheme: nt.simulate(NONTWISTING, t_end=1, step=0.1, integrator=scheme(dissipation=0.1))
            for scheme in SCHEMES
        ),
    ]
)


FILE = """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity.body = [0.1, 2.0, 0.1]
time = { t_end = 4, step = 0.1 }
integrator = { name = "lie-midpoint", order = 1, options = { dissipation = 0.1 } }
sweep.over = [{ key = "integrator.options.dissipation", kind = "list", values = [0.25, 0.5, 1.0] }]
sweep.variables = ["kinetic_energy"]
"""


def test_in_run_files_and_sweeps(write, tmp_path):
    found = sweep(write(FILE), tmp_path / "found.zarr").kinetic_energy.values
    how = {"t_end": 4, "step": 0.1, "material_angular_velocity": MIDDLE, "integrator": LieMidpoint(1, dissipation=0.5)}
    assert found[1] == nt.simulate(STANDARD, **how).kinetic_energy.values[-1]
    assert (np.diff(found) < 0).all()


@pytest.mark.parametrize(("v", "p", "expected"), [(1.0, 2.0, 3 / 3.3), (2.0, 1.0, 3 / 2.7), (0.0, 0.0, 1.0)])
def test_steady_director_is_not_slowed(v, p, expected):
    """Nor one at rest: by the quotient of (p + v) and χ (p - v) + p + v."""
    found, slope = gain(0.3, v, p)
    assert found == pytest.approx(expected, rel=1e-15)
    if v > 0:
        assert slope == pytest.approx((gain(0.3, v, p + 1e-5)[0] - gain(0.3, v, p - 1e-5)[0]) / 2e-5, rel=1e-8)
