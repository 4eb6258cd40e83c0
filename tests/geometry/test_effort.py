"""The least effort reaches its target, is that of Pontryagin's equations, and goes no shorter way than `steer`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from conftest import PAPER_J as J
from nontwist import heavy_top, least_effort, nontwisting, rotations, simulate, standard, suslov
from nontwist.driver import effort
from refusals import refused_as

EYE = Rotation.identity()
SKEW = Rotation.from_rotvec([0.9, -0.7, 1.1])


def test_half_turn_at_rest():
    """As another integrator, SciPy's, has it; in ten times the time, of twice the inertia, in the same way."""
    target = Rotation.from_rotvec([np.pi, 0, 0])
    start, how = Rotation.from_rotvec([1, -2, 0.5]), {"nodes": 11}
    found = least_effort(nontwisting(J), start, start * target, t_end=7, **how)
    assert found.gap < 1e-12
    assert found.projected_gradient < 1e-8
    run = simulate(nontwisting(J), times=[7], rotation=found.start, load=found.load, integrator="continuous")
    assert (Rotation.from_quat(run.quaternion.values[-1]).inv() * start * target).magnitude() < 1e-7
    assert abs(run.material_angular_velocity.values[-1]).max() < 1e-8
    other = least_effort(nontwisting(2 * J), start, start * target, t_end=70, **how)
    assert abs(other.effort / found.effort / (4 / 1000) - 1) < 1e-12
    assert abs(other.moment / (2 / 100) - found.moment).max() < 1e-12 * found.moment.max()
    assert other.times[-1] == 70


def test_great_circle_of_round_body():
    """The angle goes like 3t² - 2t³, and the moment is linear: the effort is 12 J²θ²/T³. No way takes none."""
    found = least_effort(nontwisting([4, 4, 5]), EYE, Rotation.from_rotvec([0.6, 0.8, 0]), t_end=2, nodes=5)
    assert abs(found.effort / (12 * 16 / 8) - 1) < 1e-12
    assert abs(found.length - 1) < 1e-12
    assert abs(found.moment[:, :2] - np.outer([24, 12, 0, -12, -24], [0.6, 0.8]) / 4).max() < 1e-10
    nothing = least_effort(nontwisting(J), SKEW, SKEW, t_end=1)
    assert nothing.effort == nothing.length == 0
    assert not nothing.moment.any()


def test_moments_are_least():
    """Pontryagin's equations ``W_i'' = p_i/J_i²``, p constant in space, shot at the target by SciPy.

    Tables are some of all moments, so their effort is larger, by less than h⁴.
    """
    moments, across, target = (2, 5, 4), np.array([2, 5]), SKEW
    found = least_effort(nontwisting(moments), EYE, target, t_end=1, nodes=41)
    assert found.gap < 1e-12

    def rates(t, x):
        R, W, dW = x[:9].reshape(3, 3), x[9:11], x[11:13]
        turn, moment = (R @ rotations.hat([*W, 0])).ravel(), across * dW
        return np.concatenate([turn, dW, (R.T @ x[13:16])[:2] / across**2, np.zeros(3), [moment @ moment]])

    def shot(z):
        x = np.concatenate([np.eye(3).ravel(), np.zeros(2), z, [0]])
        return solve_ivp(rates, (0, 1), x, "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]

    def off(z):
        x = shot(z)
        return np.concatenate([rotations.log(target.as_matrix().T @ x[:9].reshape(3, 3)), x[9:11]])

    run = simulate(nontwisting(moments), t_end=1, load=found.load, times=(found.times[1:] + found.times[:-1]) / 2)
    R = Rotation.from_quat(run.quaternion.values).as_matrix()
    slopes = np.diff(found.moment[:, :2], axis=0) / np.diff(found.times)[:, None] * across
    p = np.linalg.lstsq(np.concatenate(R.transpose(0, 2, 1)[:, :2]), slopes.ravel(), rcond=None)[0]
    solved = root(off, [*(found.moment[0, :2] / across), *p], tol=1e-10)
    assert abs(solved.fun).max() < 1e-9
    assert 0 < found.effort / shot(solved.x)[-1] - 1 < 2e-6


def asked(body, t_end=1, nodes=8):
    return lambda: least_effort(body, EYE, SKEW, t_end=t_end, nodes=nodes)


test_wrong_bodies_and_numbers = refused_as(
    {
        "standard": asked(standard(J)),
        "suslov": asked(suslov(J, (1, 0, 1))),
        "spin": asked(nontwisting(J, spin=1)),
        "top": asked(heavy_top(J, 1, (0, 0, 1))),
        "nodes": asked(nontwisting(J), nodes=3),
        "out of range": asked(nontwisting(J), t_end=1e-150),
    }
)


def test_search_ends_too_early(monkeypatch):
    monkeypatch.setattr(effort, "ITERATIONS", 1)
    with pytest.raises(RuntimeError, match=r"^no least effort .*: the projected gradient is still \d\.\de-0[12] of"):
        asked(nontwisting(J))()
