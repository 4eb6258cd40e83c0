"""The paper's scheme against what the derivation in its module says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import PAPER_J
from nontwist.models.equations import constraint_matrices
from nontwist.validation import compiled_steps as reference

EM = {"integrator": "energy-momentum", "order": 2}


@pytest.mark.parametrize("a", [0.0, 0.25, 1.0])
def test_the_parameter_a_moves_one_multiplier_only(a):
    """λ_12(a) = λ_12(1/2) - (1/2 - a) μ; q, v, μ and the other λ stay."""
    E, h = nt.nontwisting(PAPER_J).euler_inertia, 0.01
    q = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix().T
    v = np.cross(np.array([2.0, -3, 0]) @ q, q)
    load = reference.MidpointLoad(np.array([1.0, 2, 0]), np.array([0.5, 0, 1]))
    e3 = np.array([0.0, 0, 1])
    half, other = (
        reference.director_step(q, v, h, E, constraint_matrices(e3, b), np.zeros((3, 3)), load) for b in (0.5, a)
    )
    assert other.directors == pytest.approx(half.directors, abs=1e-14)
    assert other.velocities == pytest.approx(half.velocities, abs=1e-12)
    expected = half.multipliers - np.array([0, 0, 0, 0, 0, (0.5 - a) * half.multipliers[6], 0])
    assert other.multipliers == pytest.approx(expected, abs=1e-11)
    assert abs(half.multipliers[6]) > 1


def test_the_constraint_holds_in_the_mean_and_not_at_the_nodes(paper_body):
    """Under load the velocities leave the tangent space by a mode of alternating sign."""
    run = nt.simulate(paper_body, t_end=1, step=0.005, load=nt.pulse((-123.625, -53.75, 0)), **EM)
    q, v = run.directors.values, run.director_velocities.values
    qm, u = (q[1:] + q[:-1]) / 2, np.diff(q, axis=0) / 0.005
    g = np.sum(u[:, 0] * qm[:, 1] - u[:, 1] * qm[:, 0], axis=1) / 2
    assert abs(g).max() < 1e-11
    assert 1e-4 < abs(np.sum(v[:, 0] * q[:, 1], axis=1)).max() < 1.2e-3
