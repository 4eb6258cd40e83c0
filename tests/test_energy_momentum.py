"""The paper's scheme against what the derivation in its module says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, PAPER_J
from nontwist.models.constraints import constraint_matrices
from nontwist.validation import compiled_steps as reference

EM = {"integrator": "energy-momentum", "order": 2}


def drift(x):
    """Largest change from the first value, relative to the largest value."""
    return abs(x - x[0]).max() / abs(x).max()


def test_a_suslov_body_keeps_energy_only():
    run = nt.simulate(BODIES["suslov"](), t_end=1, step=0.005, material_angular_velocity=[3, 1, 0], project=True, **EM)
    assert drift(run.kinetic_energy.values) < 1e-12
    assert drift(run.material_momentum.values) > 0.05


def test_a_top_keeps_its_vertical_momentum():
    top = nt.simulate(BODIES["heavy_top"](), t_end=1, step=0.005, angular_velocity=[0.5, 1, 8], **EM)
    assert drift(top.spatial_momentum.sel(axis="z").values) < 1e-12
    assert drift(top.spatial_momentum.sel(axis="x").values) > 0.01


@pytest.mark.parametrize("a", [0.0, 0.25, 1.0])
def test_the_parameter_a_moves_one_multiplier_only(a):
    """λ_12(a) = λ_12(1/2) - (1/2 - a) μ; q, v, μ and the other λ stay."""
    E, h = nt.nontwisting(PAPER_J).euler_inertia, 0.01
    q = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix().T
    v = np.cross(np.array([2.0, -3, 0]) @ q, q)
    load = reference.MidpointLoad(np.array([1.0, 2, 0]), np.array([0.5, 0, 1]))
    e3 = np.array([0.0, 0, 1])
    half, other = (
        reference.director_step(0, q, v, h, E, constraint_matrices(e3, b), np.zeros((3, 3)), load) for b in (0.5, a)
    )
    assert other.directors == pytest.approx(half.directors, abs=1e-14)
    assert other.velocities == pytest.approx(half.velocities, abs=1e-12)
    expected = half.multipliers - np.array([0, 0, 0, 0, 0, (0.5 - a) * half.multipliers[6], 0])
    assert other.multipliers == pytest.approx(expected, abs=1e-11)
    assert abs(half.multipliers[6]) > 1


def test_damping_takes_energy_away():
    run = nt.simulate(
        BODIES["nontwisting"](), t_end=1, step=0.01, angular_velocity=[3, 1, 0], load=nt.damping(2.0), **EM
    )
    assert (np.diff(run.kinetic_energy) < 0).all()


def test_a_moving_moment_along_the_constrained_axis_shows_in_the_reaction_only(paper_body):
    W = {"material_angular_velocity": [1, 2, 0]}
    without = nt.simulate(paper_body, t_end=0.2, step=0.01, **W, **EM)
    along = nt.simulate(paper_body, t_end=0.2, step=0.01, load=nt.body_moment(lambda t: (0, 0, 3 * t)), **W, **EM)
    assert along.directors.values == pytest.approx(without.directors.values, abs=1e-13)
    extra = (along.multipliers - without.multipliers).sel(constraint="nh")
    assert extra.values == pytest.approx(3 * along.midtime.values, rel=1e-4)


def test_the_constraint_holds_in_the_mean_and_not_at_the_nodes(paper_body):
    """Under load the velocities leave the tangent space by a mode of alternating sign."""
    run = nt.simulate(paper_body, t_end=1, step=0.005, load=nt.pulse((-123.625, -53.75, 0)), **EM)
    q, v = run.directors.values, run.director_velocities.values
    qm, u = (q[1:] + q[:-1]) / 2, np.diff(q, axis=0) / 0.005
    g = np.sum(u[:, 0] * qm[:, 1] - u[:, 1] * qm[:, 0], axis=1) / 2
    assert abs(g).max() < 1e-11
    assert 1e-4 < abs(np.sum(v[:, 0] * q[:, 1], axis=1)).max() < 1.2e-3


def test_a_plate_and_a_body_at_rest():
    run = nt.simulate(nt.standard([1, 1, 2]), t_end=0.2, step=0.01, angular_velocity=[1, 2, 3], **EM)
    assert drift(run.kinetic_energy.values) < 1e-13
    rest = nt.simulate(nt.standard([1, 1, 1.5]), t_end=0.2, step=0.01, **EM)
    assert np.array_equal(rest.directors[-1], np.eye(3))
