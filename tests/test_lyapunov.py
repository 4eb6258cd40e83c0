"""Lyapunov exponents: closed forms, sums, and the growth of the tangents of `sensitivities`."""

import numpy as np
import pytest

from nontwist import damping, heavy_top, lyapunov, nontwisting, sensitivities, standard

J = np.array([[3, 0.1, -0.2], [0.1, 4, 0.15], [-0.2, 0.15, 5]])
C = np.array([[0.1, 0.02, 0], [0.02, 0.2, 0.03], [0, 0.03, 0.3]])
W0 = (0.4, -1.1, 0.7)


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_the_middle_axis_is_left_at_the_known_rate(scheme):
    """Neighbours of a rotation about the middle axis leave it like ``exp(σt)``, σ² = W² (J3-J2)(J2-J1)/(J1 J3)."""
    how = {"t_end": 400, "step": 0.02, "material_angular_velocity": (0, 2, 0), "integrator": scheme}
    found = lyapunov(standard([3, 4, 5]), **how).lyapunov_exponent
    rate = 2 / np.sqrt(15)
    growth = (found * found.time).values
    late = (growth[-1] - growth[len(growth) // 2]) / (found.time.values[-1] - found.time.values[len(growth) // 2])
    assert abs(late[[0, -1]] - [rate, -rate]).max() < (1e-9 if scheme == "gauss" else 1e-4)
    assert abs(late[1:-1]).max() < 0.02


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_sums_are_the_growth_of_volumes(scheme):
    how = {"t_end": 20, "step": 0.05, "material_angular_velocity": W0, "integrator": scheme}
    damped = lyapunov(standard(J), load=damping(C), **how).lyapunov_exponent.values[-1].sum()
    assert abs(damped + np.trace(np.linalg.solve(J, C))) < (1e-12 if scheme == "gauss" else 1e-3)
    heavy = lyapunov(heavy_top(J, 1, (0.1, 0.2, 0.5)), **how).lyapunov_exponent.values
    if scheme != "energy-momentum":  # of whose twelve directions these are six
        d = sensitivities(heavy_top(J, 1, (0.1, 0.2, 0.5)), wrt=["rotation", "material_angular_velocity"], **how)
        X = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
        assert abs(20 * heavy[-1].sum() - np.log(abs(np.linalg.det(X)))) < 1e-11


def test_chaos_of_a_heavy_top_and_order_without_weight():
    start = {"t_end": 300, "step": 0.05, "material_angular_velocity": (1, 2, 1)}
    chaotic = lyapunov(heavy_top([3, 2.5, 1], 1, (0.1, 0.2, 1)), **start).lyapunov_exponent.values
    assert chaotic[-1, 0] > 0.3
    assert abs(chaotic[-1] + chaotic[-1, ::-1]).max() < 0.05  # pairs
    assert chaotic.shape[1] == 6
    start["material_angular_velocity"] = (1, 0.5, 2)  # (1, 2, 1) is on the separatrix of the free body
    regular = lyapunov(standard([3, 2.5, 1]), **start).lyapunov_exponent.values[-1]
    assert abs(regular).max() < 0.05


def test_a_constrained_body_has_five():
    """Without load a non-twisting body goes on along its circle: nothing grows but linearly."""
    found = lyapunov(nontwisting([3, 4, 5]), t_end=300, step=0.05, material_angular_velocity=(1, 2, 0))
    assert found.sizes["exponent"] == 5
    assert abs(found.lyapunov_exponent.values[-1]).max() < 0.05
    assert found.lyapunov_exponent.units == "s-1"
