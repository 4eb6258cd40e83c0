"""Dissipation of energy with the momentum kept, as an option of the two midpoint schemes."""

from itertools import product

import numpy as np
import pytest

import nontwist as nt
from nontwist.analysis.invariants import drifts
from nontwist.integrators import EnergyMomentum, LieMidpoint
from nontwist.runfile import read_run_file
from nontwist.sweeps import sweep
from refusals import said, says

J = np.array([[3, 0.2, 0.1], [0.2, 4, -0.3], [0.1, -0.3, 5.0]])
MIDDLE = (0.1, 2.0, 0.1)
SCHEMES = [LieMidpoint, EnergyMomentum]
pytestmark = pytest.mark.filterwarnings("ignore:.*rad a step", "ignore:.*runs in Python")


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("step", [0.02, 0.2, 0.8])
def test_energy_never_rises_and_momentum_stays(scheme, order, step):
    run = nt.simulate(
        nt.standard(J), t_end=80, step=step, material_angular_velocity=MIDDLE, integrator=scheme(order, dissipation=0.8)
    )
    K, pi = run.kinetic_energy.values, run.spatial_momentum.values
    least = pi[0] @ pi[0] / (2 * np.linalg.eigvalsh(J)[-1])
    assert np.diff(K).max() <= 1e-14 * K[0]
    assert K[-1] < K[0] - 1e-3
    assert K.min() >= least * (1 - 1e-13)
    assert abs(pi - pi[0]).max() < 3e-13


LOAD = nt.pulse((1, 2, 3), 0, 0.7) + nt.damping(0.1) + nt.pulse((0, 2, 1), 0, 1, frame="space")


@pytest.mark.parametrize("load", [None, LOAD])
def test_energy_momentum_loses_what_its_derivation_says_under_any_load(load):
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
def test_lie_midpoint_loses_what_its_derivation_says(load, order):
    """Δ(K + V) less the work is -g (Q × W_m)·ΔP, with the impulse of the load as it is."""
    h, chi = 0.05, 0.6
    how = {"t_end": 2, "step": h, "material_angular_velocity": MIDDLE, "load": load}
    run = nt.simulate(nt.standard([3, 4, 5]), integrator=LieMidpoint(order, dissipation=chi), **how)
    W = run.material_angular_velocity.values
    middle, dP = (W[1:] + W[:-1]) / 2, np.diff(W, axis=0) * [3, 4, 5]
    g = chi * h / 12 * (1 if order == 1 else h * np.linalg.norm(middle, axis=1))
    lost = -g * (np.cross(middle * [3, 4, 5], middle) * dP).sum(axis=1)
    bound = 3e-14 if load is None else 1e-13
    assert abs(np.diff(run.kinetic_energy.values) - run.load_work.values - lost).max() < bound
    assert abs(np.diff(run.spatial_momentum.values, axis=0) - h * run.moment.values).max() < 1e-13


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_permanent_rotation_loses_nothing(scheme):
    for order, W in product((1, 2), 2.0 * np.eye(3)):
        how = {"t_end": 5, "step": 0.1, "integrator": scheme(order, dissipation=1), "material_angular_velocity": W}
        assert (nt.simulate(nt.standard([3, 4, 5]), **how).material_angular_velocity.values == W).all()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("order", [1, 2])
def test_the_measured_order(scheme, order):
    load = nt.damping(0.1) + nt.pulse((1, 2, 3), -1, 3, frame="space")
    how = {"t_end": 2, "material_angular_velocity": MIDDLE, "load": load}
    exact = nt.simulate(nt.standard(J), **how).directors[-1]
    runs = (
        nt.simulate(nt.standard(J), step=2 / n, integrator=scheme(order, dissipation=0.7), **how)
        for n in (256, 512, 1024)
    )
    errors = [abs(run.directors[-1] - exact).max().item() for run in runs]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rotation_ends_about_the_axis_of_the_largest_moment(scheme):
    how = {"t_end": 2000, "step": 0.2, "store": "end", "material_angular_velocity": MIDDLE}
    run = nt.simulate(nt.standard([3, 4, 5]), integrator=scheme(1, dissipation=1), **how)
    pi = run.spatial_momentum.values
    W = run.material_angular_velocity.values[-1]
    assert abs(abs(W[2]) - np.linalg.norm(pi[0]) / 5) < 1e-3
    assert abs(pi[-1] - pi[0]).max() < 1e-12


@pytest.mark.parametrize("scheme", SCHEMES)
def test_without_dissipation_the_bits_are_those_of_the_scheme_and_with_it_energy_is_not_kept(scheme):
    how = {"t_end": 4, "step": 0.1, "material_angular_velocity": MIDDLE}
    schemes = scheme(), scheme(dissipation=0), scheme(dissipation=0.5)
    plain, zero, run = (nt.simulate(nt.standard(J), integrator=one, **how) for one in schemes)
    assert (plain.quaternion.values == zero.quaternion.values).all()
    assert [one.symbol for one in drifts(run).values()] == ["π", "d·d"]
    assert max(one.relative for one in drifts(run).values()) < 1e-14


@pytest.mark.parametrize(
    "options", [{"dissipation": 1.5}, {"dissipation": -0.1}, {"order": 1}, {"order": 3, "dissipation": 0.1}]
)
def test_wrong_options_are_refused(options):
    with says():
        LieMidpoint(**options)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_constrained_bodies_are_refused(scheme):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole message is compared
        nt.simulate(nt.nontwisting([3, 4, 5]), t_end=1, step=0.1, integrator=scheme(dissipation=0.1))
    said(str(caught.value))


FILE = """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity.body = [0.1, 2.0, 0.1]
time = { t_end = 4, step = 0.1 }
integrator = { name = "NAME", order = 1, options = { dissipation = 0.5 } }
"""
SWEEP = """
sweep.over = [{ key = "integrator.options.dissipation", kind = "list", values = [0.25, 0.5, 1.0] }]
sweep.variables = ["kinetic_energy"]
"""


@pytest.mark.parametrize("scheme", SCHEMES)
def test_in_run_files_and_sweeps(tmp_path, scheme):
    path, text = tmp_path / "run.toml", FILE.replace("NAME", scheme.name)
    path.write_text(text, encoding="utf-8")
    run = nt.simulate(read_run_file(path).problem)
    how = {"t_end": 4, "step": 0.1, "material_angular_velocity": MIDDLE}
    alone = nt.simulate(nt.standard([3, 4, 5]), integrator=scheme(1, dissipation=0.5), **how)
    assert (run.quaternion.values == alone.quaternion.values).all()
    path.write_text(text + SWEEP, encoding="utf-8")
    found = sweep(path, tmp_path / "found.zarr")
    assert found.kinetic_energy.values[1] == alone.kinetic_energy.values[-1]
    assert (np.diff(found.kinetic_energy.values) < 0).all()
