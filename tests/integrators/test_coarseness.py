"""Steps that are too coarse: what a run says of them, once, and that `nontwist check` says the same before."""

import re
import warnings

import numpy as np
import pytest

from conftest import NONTWISTING, STANDARD, ended
from nontwist import integrate, propagator, pulse, simulate, simulate_ensemble, standard
from nontwist.errors import SimulationError
from nontwist.integrators import Gauss, LieMidpoint, Split
from nontwist.integrators.gauss import LARGEST_TURN
from nontwist.integrators.gauss_coefficients import nodes
from refusals import said, says

BODY = STANDARD
COARSE = (
    r"^the step is coarse: the body may turn by ([\d.e+]+) degrees in it, and a steady rotation as fast would be "
    r"([\d.e+]+) degrees off at the end \((\S+), order (\d+)\); try step <= (\S+), .*or tolerance = 1e-6$"
)
RUN = """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity.body = [8, 0, 0]
time = { t_end = 10, step = 0.5 }
"""


def told(run):
    """Return what a run says of its step, and its turn and error in rad."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = run()
    texts = [str(one.message) for one in caught if "coarse" in str(one.message)]
    assert len(texts) <= 1
    return found, texts[0] if texts else None


def test_hopeless_step_warns_once():
    """Of a steady rotation the numbers can be had by hand: order 2 turns by 2 atan(θ / 2) instead of θ."""
    start = {"material_angular_velocity": (4, 0, 0), "integrator": LieMidpoint(order=2)}
    run, text = told(lambda: simulate(BODY, t_end=10, step=0.5, **start))
    turn, off, name, order, fine = re.match(COARSE, text).groups()
    assert float(turn) == pytest.approx(np.degrees(2), rel=5e-3)
    assert float(off) == pytest.approx(np.degrees(20 * (2 - 2 * np.arctan(1))), rel=0.05)
    assert (name, order) == ("lie-midpoint", "2")
    assert run.attrs["warning"] == text
    assert float(fine) < 0.05
    said(text)  # in plain numbers: 492° are missing, not 4.9e+02°
    assert told(lambda: integrate(BODY, t_end=10, step=10 / np.ceil(10 / float(fine)), **start))[1] is None


@pytest.mark.parametrize("scheme", [LieMidpoint(), *map(Gauss, (2, 4, 6, 8)), *map(Split, (2, 4, 6))])
def test_error_of_steady_rotation(scheme):
    assert np.log2(scheme.lag(1.0) / scheme.lag(0.5)) == pytest.approx(scheme.order + 1, abs=0.3)


def test_prepared_calls_warn_alike():
    """From the second run of a plan on nothing is checked anew."""
    fast, plan = (4, 0, 0), {"t_end": 10, "step": 0.5, "integrator": "lie-midpoint"}
    texts = [told(lambda: integrate(BODY, material_angular_velocity=fast, **plan))[1] for _ in range(3)]
    texts.append(told(lambda: propagator(BODY, **plan)(material_angular_velocity=fast))[1])
    assert len(set(texts)) == 1
    assert re.match(COARSE, texts[0])
    assert told(lambda: integrate(BODY, material_angular_velocity=(0.1, 0, 0), **plan))[1] is None


def test_load_off_the_grid():
    plan = {"t_end": 1, "step": 0.1, "load": pulse((1, 0, 0), start=0.25, end=0.55), "integrator": "lie-midpoint"}
    for _ in range(3):
        with pytest.warns(UserWarning, match="2 breakpoint"):
            integrate(BODY, **plan)


def test_check_warns_as_run(here, write):
    """About the axis of the smallest inertia the bound of |w| is its value."""
    write(RUN)
    checked, ran = (ended(0, command, "run.toml") for command in ("check", "run"))
    sentence = checked.stderr.split("warning: ")[1].splitlines()[0]
    assert re.match(COARSE, sentence)
    assert sentence in ran.stderr
    assert "the step is coarse" in ran.stdout
    assert "coarse" not in ended(0, "run", "run.toml", "--set", "time.step=0.01", "--force").output


def test_the_worst_member_is_told():
    velocities = [(0, 0.1, 0), (0, 8, 0)]
    many, text = told(
        lambda: simulate_ensemble(BODY, t_end=2, step=0.5, material_angular_velocity=velocities, integrator="gauss")
    )
    assert re.match(COARSE, text)
    assert many.attrs["warning"] == text


def turning(theta, scheme, steps=4):
    """Return what is said of a body that turns steadily by theta a step."""
    start = {"material_angular_velocity": (0, theta, 0)}
    return told(lambda: integrate(NONTWISTING, t_end=steps, step=1, integrator=scheme, **start))[1]


def stage_matrix(order):
    c, k = nodes(order), np.arange(order // 2)
    return (c[:, None] ** (k + 1) / (k + 1)) @ np.linalg.inv(c[:, None] ** k)


@pytest.mark.parametrize("order", Gauss.orders)
def test_gauss_limits_from_the_matrix(order):
    """The iteration of the rows of a steady rotation contracts by θ ρ(A); its stages leave the circle by 0.1."""
    limit, A = LARGEST_TURN[order], stage_matrix(order)
    assert limit * abs(np.linalg.eigvals(A)).max() == pytest.approx(0.5, rel=5e-3)
    stages = np.linalg.solve(np.eye(order // 2) - 1j * limit * A, np.ones(order // 2))
    assert abs(abs(stages) ** 2 - 1).max() <= (0.25 if order == 2 else 0.1)
    assert turning(1.01 * limit, Gauss(order=order)) is not None
    assert order < 6 or turning(0.99 * limit, Gauss(order=order), 1) is None


def test_error_of_a_tenth():
    scheme = LieMidpoint(order=2)
    assert turning(0.1, scheme, 1000) is None  # 1000 * 0.1³ / 12 = 0.083
    assert turning(0.1, scheme, 1300) is not None
    for exact in (Split(order=2), "exact"):
        assert turning(30.0, exact) is None
    for name in ("lie-midpoint", "gauss", "split"):  # which choose their steps
        assert told(lambda name=name: integrate(BODY, t_end=3, angular_velocity=(1, 9, 0), integrator=name))[1] is None


def test_exponentials_under_frame_moments():
    """Kicked about its own axis alone it turns steadily: what the warning speaks of is exact, and is not said."""
    how = {"t_end": 100, "step": 0.25, "material_angular_velocity": (2, 0, 0), "integrator": Split(order=2)}
    load = pulse((0, 0, 1), 1, 2)
    run, text = told(lambda: integrate(NONTWISTING, load=load, **how))
    assert text is None
    np.testing.assert_allclose(run.rotation[-1].as_rotvec() - [200 - 64 * np.pi, 0, 0], 0, atol=1e-12)
    assert "coarse" in told(lambda: integrate(BODY, load=load, **how))[1]


def test_propagator_warns_again_when_faster():
    run = propagator(BODY, t_end=10, step=0.05, integrator="gauss", order=8)
    speeds = (2, 12, 60.5, 60.5, 2, 60, 61)
    found = [told(lambda W=(speed, 0, 0): run(material_angular_velocity=W)) for speed in speeds]
    assert [text is not None for _, text in found] == [False, False, True, False, False, False, True]
    assert [one.warning is not None for one, _ in found] == [False, False, True, True, False, True, True]


def test_step_names_the_turn():
    with says(SimulationError):
        integrate(standard([1, 2, 3]), t_end=20, step=1, material_angular_velocity=(0.01, 5, 0), integrator="gauss")
