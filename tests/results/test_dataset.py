import json

import numpy as np
import pytest
import xarray

from conftest import BODIES
from nontwist import DirectorSystem, integrate, open_run, rotation, rotor, save_run, simulate, sine
from nontwist.analysis.variables import DERIVATIVES, EVENTS, LOADED, MEMBERS, ROTORS, VARIABLES, WHEELS
from nontwist.comparison import observed_order, second_quotient
from refusals import says

OTHERS = {*EVENTS, *ROTORS, *WHEELS, *LOADED, *DERIVATIVES, *MEMBERS}  # of some runs alone

KICK = {
    "t_end": 0.3,
    "step": 0.01,
    "angular_velocity": [1, -2, 0.5],
    "project": True,
    "load": sine([1, 2, 0.5], 3),
    "integrator": "energy-momentum",
}


@pytest.fixture(scope="module", params=list(BODIES))
def run(request):
    return simulate(BODIES[request.param](), **KICK)


def test_attributes_of_variables(run):
    for name, variable in run.data_vars.items():
        assert variable.dims == VARIABLES[name][0]
        assert all(variable.attrs[key] for key in ("units", "long_name", "symbol"))
        assert np.isfinite(variable).all()
    missing = set(VARIABLES) - set(run.data_vars) - OTHERS
    has_axis = json.loads(run.attrs["system"])["axis"] is not None
    assert missing == (set() if has_axis else {"reaction_moment", "spatial_reaction_moment"})
    assert list(run.constraint.values) == ["11", "22", "33", "23", "13", "12", *(["nh"] if has_axis else [])]
    assert list(run.axis.values) == ["x", "y", "z"]
    assert list(run.director.values) == [1, 2, 3]
    assert run.midtime.values == pytest.approx((run.time.values[1:] + run.time.values[:-1]) / 2)


def test_absent_variables():
    lie = {**KICK, "integrator": "lie-midpoint"}
    run = simulate(BODIES["standard"](), **lie)
    missing = set(VARIABLES) - OTHERS - set(run.data_vars)
    assert missing == {"multipliers", "reaction_moment", "spatial_reaction_moment"}
    held = simulate(BODIES["suslov"](), **lie)
    assert list(held.constraint.values) == ["nh"]
    assert np.array_equal(held.reaction_moment, -held.multipliers.sel(constraint="nh"))


def test_observables_are_the_papers(run):
    """π^i = Σ E_ij d_j', π = Σ d_i × π^i, Π_i = d_i·π, K = 1/2 Σ d_i'·π^i, w = 1/2 Σ d_i × d_i' (eq-dir-momenta)."""
    body = DirectorSystem.from_json(run.attrs["system"])
    E = body.euler_inertia
    for k in (0, 7, 30):
        q, v = run.directors[k].values, run.director_velocities[k].values
        p = np.array([sum(E[i, j] * v[j] for j in range(3)) for i in range(3)])
        pi = sum(np.cross(q[i], p[i]) for i in range(3))
        w = sum(np.cross(q[i], v[i]) for i in range(3)) / 2
        assert run.spatial_momentum[k].values == pytest.approx(pi, abs=1e-13)
        assert run.material_momentum[k].values == pytest.approx([d @ pi for d in q], abs=1e-13)
        assert float(run.kinetic_energy[k]) == pytest.approx(sum(v[i] @ p[i] for i in range(3)) / 2)
        assert run.angular_velocity[k].values == pytest.approx(w, abs=1e-13)
        assert run.material_angular_velocity[k].values == pytest.approx(q @ w, abs=1e-13)
        n = body.axis if body.axis is not None else np.array([0, 0, 1.0])
        assert float(run.twist_rate[k]) == pytest.approx(w @ (n @ q), abs=1e-13)
        assert float(run.potential_energy[k]) == pytest.approx(-np.sum(body.dead_force * q), abs=1e-13)
    W = run.material_angular_velocity[0].values
    assert run.material_momentum[0].values == pytest.approx(body.convected_inertia @ W, abs=1e-12)
    assert float(run.kinetic_energy[0]) == pytest.approx(W @ body.convected_inertia @ W / 2)


def test_trajectory_equals_dataset():
    how = KICK | {"load": rotor((1, 2, 0), [0.1, 0.3], [1.0, 2.5])}
    run, kinked = (integrate(BODIES["standard"](), **how | {"step": step}) for step in (0.01, None))
    assert json.loads(kinked.record()["segments"])["borders"] == [0.0, 0.1, 0.3]
    assert np.array_equal(run.rotor_momentum, run.to_dataset().rotor_momentum)
    rest = integrate(BODIES["standard"](), t_end=0.5, step=0.01, start=run)  # on the same grid
    assert (run.origin, rest.origin, rest.to_dataset().attrs["origin"]) == (None, 0.0, 0.0)
    plain = integrate(BODIES["standard"](), times=[0, 0.1], angular_velocity=[1, -2, 0.5], integrator="exact")
    assert (plain.rotor_momentum, plain.t_events, plain.origin, plain.step) == (None, [], None, None)


def test_rotation_and_quaternion(run):
    R = rotation(run)
    assert R.as_matrix() == pytest.approx(np.swapaxes(run.directors.values, 1, 2), abs=1e-13)
    assert R.apply([0, 0, 1]) == pytest.approx(run.directors.sel(director=3).values, abs=1e-13)
    for same in (run.quaternion, run.directors.transpose("axis", "time", "director")):
        assert (rotation(same) * R.inv()).magnitude() == pytest.approx(0, abs=1e-13)
    for labels in ({"director": [3, 1, 2]}, {"axis": ["z", "x", "y"]}):
        assert np.array_equal(rotation(run.directors.sel(labels)).as_matrix(), rotation(run.directors).as_matrix())
    assert (np.sum(run.quaternion.values[1:] * run.quaternion.values[:-1], axis=1) > 0).all()


def test_place_of_the_scalar(run):
    last, first = run.quaternion, run.quaternion.sel(quat=list("wxyz"))
    unlabelled = (first.drop_vars("quat"), True), (last.drop_vars("quat"), None)
    for motion, is_first in ((first, None), (first, False), *unlabelled):
        assert np.array_equal(rotation(motion, scalar_first=is_first).as_quat(), rotation(last).as_quat())
    others = xarray.Dataset({"a": 1}), xarray.DataArray(np.zeros(3), dims="x")
    for motion in (last.assign_coords(quat=range(4)), *others):
        with says():
            rotation(motion)


def test_the_quaternion_does_not_jump():
    run = simulate(BODIES["standard"](), t_end=6, step=0.05, angular_velocity=[1, -2, 3])
    p = run.quaternion.values
    assert np.sum(p[1:] * p[:-1], axis=1).min() > 0.99
    assert (rotation(run).as_quat()[:, 3] * p[:, 3] < 0).any()


def test_record_runs_again(run, tmp_path):
    save_run(run, tmp_path / "run.nc")
    stored = open_run(tmp_path / "run.nc")
    xarray.testing.assert_identical(stored, run)
    system, how = DirectorSystem.from_json(stored.attrs["system"]), json.loads(stored.attrs["integrator"])
    begin = {"rotation": stored.directors[0], "angular_velocity": stored.angular_velocity[0], "project": True}
    how = {"integrator": how["name"], "order": how["order"], "step": stored.attrs["step"], "load": KICK["load"]}
    again = integrate(system, t_end=float(stored.time[-1]), **begin, **how)
    assert again.directors == pytest.approx(run.directors.values, abs=1e-12)
    record = {"kind": "body", "scale": 1.0, "sine": [1, 2, 0.5], "frequency": 3, "phase": 0}
    assert json.loads(stored.attrs["load"]) == [record]
    assert stored.attrs["status"] == 0


def test_observed_order():
    """At the nearest times, whatever their round-off."""
    how = {"t_end": 0.5, "angular_velocity": [1, 2, 3], "order": 2}
    runs = [simulate(BODIES["standard"](), step=0.01 / k, **how) for k in (1, 2, 4)]
    quotient = second_quotient(*runs)
    assert quotient.dims == ("time",)
    assert quotient.sizes["time"] == 50
    assert np.array_equal(observed_order(*runs), np.log2(quotient))
    assert float(observed_order(*runs)[-1]) == pytest.approx(2, abs=0.01)
    for off in (1e-12, -1e-12):
        others = [run.assign_coords(time=run.time + off) for run in runs[1:]]
        assert np.array_equal(second_quotient(runs[0], *others), quotient)
    short = [runs[0], runs[1].isel(time=slice(0, 50)), runs[2]]
    for wrong, variable in (((runs[0], runs[2], runs[1]), "directors"), (runs, "speed"), (short, "directors")):
        with says():
            second_quotient(*wrong, variable=variable)
