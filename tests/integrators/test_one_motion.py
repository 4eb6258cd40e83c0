"""A motion is the same however it is run: under loads with memory, and where runs are taken apart."""

import numpy as np
import pytest

import nontwist as nt
from loads.test_dry_wheels import PAIR
from loads.test_friction import PENDULUM, TILTED
from loads.test_memory import START, load
from loads.test_wheels import RUBBING, SKEW, W0, J

TURNING = {"material_angular_velocity": W0}
MOTIONS = {  # how, and how far off a run is that is taken up again
    "dry friction": (PENDULUM, TILTED, {"load": nt.dry_friction(1, "x"), "step": 0.04}, 1e-13),
    "dry wheels": (nt.standard(J), TURNING, {"load": PAIR, "step": 0.1}, 1e-13),
    "wheels with friction": (nt.standard(J), TURNING, {"load": RUBBING, "step": 0.1, "order": 8}, 1e-13),
    "driven wheels": (nt.standard(J), TURNING, {"load": SKEW, "step": 0.1, "integrator": "lie-midpoint"}, 1e-14),
    "memory": (nt.standard(J), {"material_angular_velocity": START}, {"load": load(), "step": 0.1}, 0.0),
}
AT, END = np.array([0.123, 1.041, 2.0]), 2.2


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
    half = nt.simulate(body, t_end=1.0, **start, **how)
    nt.save_run(half, tmp_path / "half.nc")
    for begin in (nt.integrate(body, t_end=1.0, **start, **how), nt.open_run(tmp_path / "half.nc")):
        rest = nt.simulate(body, start=begin, t_end=END, **how)
        require(rest, whole, near, slice(len(half.time) - 1, None))
    both = nt.resample(nt.join_runs(half, rest), AT, load=how["load"])
    require(both, asked, 1e-12)
    ensemble = {"load_scale": [1, 0.5], "variables": "all", **how}  # whose members are runs: see test_contract
    starts = {key: value if key == "rotation" else [value] * 2 for key, value in start.items()}
    many = nt.simulate_ensemble(body, t_end=1.0, **starts, **ensemble)
    more = nt.simulate_ensemble(body, start=many, t_end=END, **ensemble)
    require(more.isel(member=0, time=[-1]), whole, 1e-12, [-1])
