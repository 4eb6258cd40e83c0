"""A propagator gives the bits of `integrate`, from any number of threads, and refuses what it refuses."""

import copy
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import turning
from integrators.test_contract import require_same_run as same
from nontwist import Load, integrate, moment, nontwisting, propagator, sine, standard
from nontwist.errors import SimulationError
from refusals import refused_as, says

R = Rotation.from_rotvec([0.3, -0.2, 0.9])
W0 = (0.5, -1.0, 0.2)


def test_forms_of_a_start():
    """The bits of one form, for every load and body, are in test_contract."""
    body, load = standard([3, 4, 5]), sine((1, 2, 3), 0.7)
    how = {"t_end": 0.6, "step": 0.05, "store": 5, "integrator": "lie-midpoint", "project": True, "load": load}
    call = propagator(body, **how)
    for start in (
        {"material_angular_velocity": np.array(W0), "rotation": R},
        {"angular_velocity": W0, "rotation": R.as_matrix()},
        {"material_angular_velocity": W0, "rotation": R.as_quat(), "scalar_first": False},
    ):
        same(call(**start), integrate(body, **how, **start))
    first = integrate(body, **how | {"t_end": 0.3}, material_angular_velocity=W0)
    same(propagator(body, **how, t_start=0.3)(start=first), integrate(body, **how, start=first))


def test_eight_threads_share_one():
    call = propagator(standard([3, 4, 5]), t_end=0.1, step=0.01, order=4, load=sine((1, 0, 2), 3))
    starts = [tuple(W) for W in np.random.default_rng(3).normal(size=(100, 3)).tolist()]

    def ends(k):
        runs = [call(material_angular_velocity=W) for W in starts[k:] + starts[:k]]
        return np.roll([[*run.quaternion[-1], *run.memory, *run.moment[0]] for run in runs], k, axis=0)

    alone = ends(0)
    with ThreadPoolExecutor(8) as pool:
        for found in pool.map(ends, [*range(0, 100, 5)] * 2):  # 4000 calls
            assert np.array_equal(found, alone)


def test_step_for_each_start():
    body, how = nontwisting([3, 4, 5]), {"t_end": 1, "store": "end"}
    call, starts = propagator(body, **how), [{"angular_velocity": (0, speed, 0)} for speed in (1, 40)]
    for start in starts:
        same(call(**start), integrate(body, **how, **start))
    assert call(**starts[1]).step < call(**starts[0]).step


def test_failing_run():
    body, how = standard([3, 4, 5]), {"t_end": 1, "step": 0.5, "store": "end"}
    call = propagator(body, **how)
    with says(SimulationError):
        call(material_angular_velocity=(0, 0, 20))
    same(call(material_angular_velocity=W0), integrate(body, material_angular_velocity=W0, **how))


BODY, PLAN = nontwisting([3, 4, 5]), {"t_end": 1, "step": 0.1}
test_wrong_starts_and_plans = refused_as(
    {
        "shape": lambda: propagator(BODY, **PLAN)(material_angular_velocity=(1, 2)),
        "scale": lambda: propagator(BODY, **PLAN)(load_scale="twice"),
        "resolution": lambda: propagator(BODY, t_end=1e9 + 1, t_start=1e9, step=1e-6),
    }
)


def test_slow_load_warns_once():
    with pytest.warns(UserWarning, match="runs in Python"):
        call = propagator(BODY, load=moment(turning), **PLAN)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        call(angular_velocity=(0, 1, 0))


def test_pickle_and_repr():
    call = propagator(BODY, t_end=2, step=0.1, load=sine((1, 0, 0), 1), order=4)
    same(pickle.loads(pickle.dumps(call))(angular_velocity=(0, 1, 0)), call(angular_velocity=(0, 1, 0)))
    assert repr(call).endswith(", gauss of order 4, 0 to 2 s, 20 steps>")
    assert (call.t_start, call.t_end, call.integrator.name) == (0, 2, "gauss")
    assert isinstance(call.load, Load)


def test_results_are_read_late():
    """A call leaves them in the numbers of the march; a run is whole to whoever looks at it, copies or pickles it."""
    how, start = {"load": sine((1, 0, 0), 1), **PLAN}, {"material_angular_velocity": (0, 1, 0)}
    call, expected = propagator(BODY, store=1, **how), integrate(BODY, **how, **start)
    run = call(**start)
    assert "states" not in vars(run)
    call(material_angular_velocity=(3, 2, 0))
    for make in (lambda run: run, copy.deepcopy, lambda run: pickle.loads(pickle.dumps(run))):
        same(make(run), expected)
        run = call(**start)
    same(replace(run, message="as it was"), replace(expected, message="as it was"))
    with ThreadPoolExecutor(8) as pool:
        assert len({moment.tobytes() for moment in pool.map(lambda _: run.moment, range(100))}) == 1
    with pytest.raises(AttributeError, match="'Trajectory' object has no attribute 'velocity'"):
        run.velocity  # noqa: B018
