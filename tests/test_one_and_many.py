"""A run is a stack of one: a member of an ensemble has, in every variable, the bits of a run of its own."""

import numpy as np
import pytest

from conftest import compiled_load, turning
from nontwist import (
    DirectorSystem,
    Load,
    body_moment,
    damping,
    heavy_top,
    moment,
    nontwisting,
    pulse,
    simulate,
    simulate_ensemble,
    sine,
    standard,
    suslov,
)
from nontwist.integrators import INTEGRATORS, Exact, Split

TILTED = [[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]]
BODIES = {
    "standard": standard(TILTED),
    "nontwisting": nontwisting([3, 4, 5]),
    "suslov": suslov(TILTED, [1, 2, 3]),
    "heavy_top": heavy_top([3, 4, 5], 2.0, (0.1, 0, 0.5)),
}
T = np.linspace(0, 0.5, 6)
LOADS = {
    "none": Load(),
    "sine": sine((1, 2, 3), 0.7),
    "space": sine((1, 0.2, 3), 0.7, frame="space"),
    "pulse": pulse((3, -1, 0), 0.1, 0.2),
    "table": body_moment(T, np.outer(np.sin(9 * T), [1, 2, 0])),
    "damping": damping([0.1, 0.2, 0.3]),
    "state": None,  # compiled when it is used
    "python": moment(turning),
}
SLOW = "pulse", "table", "damping", "python"  # with `continuous`, which marches every member by itself anyway
CASES = [  # of gauss, whose kernels take long to compile, moments in space alone in the quick suite
    pytest.param(name, body, load, marks=[pytest.mark.long] if name == "gauss" and load != "space" else [])
    for name in INTEGRATORS
    for body in BODIES
    for load in LOADS
    if not (name == "continuous" and load in SLOW)
]


@pytest.mark.parametrize(("integrator", "body", "load"), CASES)
@pytest.mark.filterwarnings("ignore:the load")
def test_a_member_is_a_run_bit_for_bit(integrator, body, load):
    own, m, given = BODIES[body], 3, compiled_load(turning) if load == "state" else LOADS[load]
    rng = np.random.default_rng(11)
    q, W, scales = rng.normal(size=(m, 4)), rng.normal(size=(m, 3)), np.array([0, 0.7, -0.3])
    q /= np.linalg.norm(q, axis=1)[:, None]
    bodies = [DirectorSystem((1 + 0.1 * i) * own.euler_inertia, own.axis, own.dead_force) for i in range(m)]
    how = {"t_end": 0.5, "step": 0.05, "store": 3, "integrator": integrator, "scalar_first": False, "project": True}
    refusing = INTEGRATORS[integrator] in (Exact, Split)
    try:
        many = simulate_ensemble(
            DirectorSystem.stack(bodies),
            rotation=q,
            material_angular_velocity=W,
            load=given,
            load_scale=scales,
            variables="all",
            **how,
        )
    except ValueError:
        if not refusing:
            raise
        with pytest.raises(ValueError, match=r"exact|split"):
            simulate(bodies[0], rotation=q[0], material_angular_velocity=W[0], load=given, **how)
        return
    for i in range(m):
        scaled = float(scales[i]) * given if given.terms else None
        one = simulate(bodies[i], rotation=q[i], material_angular_velocity=W[i], load=scaled, **how)
        shared = [name for name in many.data_vars if name in one]
        assert len(shared) == 11
        for name in shared:
            assert np.array_equal(many[name][i].values, one[name].values), (name, i)
        assert np.array_equal(many.time, one.time)
