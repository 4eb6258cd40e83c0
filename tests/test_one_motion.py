"""A motion is the same however it is run: under loads with memory, and where runs are taken apart."""

import numpy as np
import pytest

import nontwist as nt
from test_dry_wheels import PAIR
from test_friction import PENDULUM, TILTED
from test_memory import START, load
from test_wheels import RUBBING, SKEW, W0, J

TURNING = {"material_angular_velocity": W0}
MOTIONS = {  # how, and how far off a run is that is taken up again
    "dry friction": (PENDULUM, TILTED, {"load": nt.dry_friction(1, "x"), "step": 0.02}, 1e-13),
    "dry wheels": (nt.standard(J), TURNING, {"load": PAIR, "step": 0.05}, 1e-13),
    "wheels with friction": (nt.standard(J), TURNING, {"load": RUBBING, "step": 0.05, "order": 8}, 1e-13),
    "driven wheels": (nt.standard(J), TURNING, {"load": SKEW, "step": 0.05, "integrator": "lie-midpoint"}, 1e-14),
    "memory": (nt.standard(J), {"material_angular_velocity": START}, {"load": load(), "step": 0.1}, 0.0),
}
AT, END = np.array([0.123, 1.5, 3.041, 5.3]), 6.0


@pytest.mark.parametrize("name", MOTIONS)
def test_ways_to_one_motion(name, tmp_path):
    body, start, how, near = MOTIONS[name]
    whole = nt.simulate(body, t_end=END, **start, **how)
    names = ["quaternion", "material_angular_velocity", *({"internal_state"} & set(whole))]

    def require(run, other, bound, at=slice(None)):
        for key in names:
            right = other[key].values[at]
            assert abs(run[key].values - right).max() <= bound * max(1.0, abs(right).max()), key

    asked = nt.simulate(body, times=AT, **start, **how)
    require(nt.resample(whole, AT, load=how["load"]), asked, 1e-12)
    with_events = nt.simulate(body, t_end=END, events=[nt.spin_below(0.4)], **start, **how)
    require(with_events, whole, 1e-13)
    for key in {"dissipated_energy", "load_work"} & set(whole):
        assert with_events[key].sum().item() == pytest.approx(whole[key].sum().item(), rel=1e-12, abs=1e-13)
    first = {**start, **how, "t_end": 3.0}
    half = nt.simulate(body, **first)
    nt.save_run(half, tmp_path / "half.nc")
    for begin in (half, nt.integrate(body, **first), nt.open_run(tmp_path / "half.nc")):
        rest = nt.simulate(body, start=begin, t_end=END, **how)
        require(rest, whole, near, slice(len(half.time) - 1, None))
    both = nt.resample(nt.join_runs(half, rest), AT, load=how["load"])
    require(both, asked, 1e-12)
    run = nt.propagator(body, t_end=END, store=1, **how)(**start)
    assert np.array_equal(run.quaternion, whole.quaternion.values)
    starts = {key: [value] * 10 for key, value in start.items() if key != "rotation"} | (
        start if "rotation" in start else {}
    )
    many = nt.simulate_ensemble(
        body, t_end=END, load_scale=[1, 0.5] * 5, variables="all", store=1, threads=2, **starts, **how
    )
    scaled = nt.simulate(body, t_end=END, **start, **how | {"load": 0.5 * how["load"]})
    for i, one in ((0, whole), (8, whole), (9, scaled)):
        require(many.isel(member=i), one, 1e-13 if one is scaled else 0.0)
    more = nt.simulate_ensemble(body, start=many, t_end=END + 1, load_scale=[1, 0.5] * 5, variables="all", **how)
    one = nt.simulate(body, t_end=END + 1, **start, **how | {"load": 0.5 * how["load"]})
    require(more.isel(member=9, time=[-1]), one, 1e-12, [-1])
