"""`join_runs`: runs that continue one another are the run that was never divided."""

import json

import numpy as np
import pytest

import nontwist as nt
from conftest import NONTWISTING, STANDARD, nontwist
from refusals import says, warned

BODY, START = NONTWISTING, {"material_angular_velocity": (0.5, 2, 0)}
HOW = {"step": 0.125, "load": nt.pulse((1, 0, 0), start=0.5, end=1.5)}


@pytest.mark.parametrize("integrator", ["gauss", "energy-momentum"])
def test_divided_run(integrator, tmp_path):
    """Of gauss to round-off, of energy-momentum bit for bit."""
    how = HOW | {"integrator": integrator}
    whole = nt.simulate(BODY, t_end=3, **how, **START)
    parts = [nt.simulate(BODY, t_end=1, **how, **START)]
    for end in (1.75, 3):
        parts.append(nt.simulate(BODY, t_end=end, start=parts[-1], **how))
    found = nt.join_runs(*parts)
    for name in whole.variables:
        if found[name].dtype.kind == "f":
            assert found[name].values == pytest.approx(
                whole[name].values, rel=0, abs=1e-13 * (integrator == "gauss")
            ), name
        assert found[name].dtype == whole[name].dtype
        assert found[name].dims == whole[name].dims
        assert found[name].attrs == whole[name].attrs
    assert found.attrs["step"] == whole.attrs["step"]
    assert [part["t_end"] for part in json.loads(found.attrs["joined"])] == [1, 1.75, 3]
    nt.save_run(found, tmp_path / "joined.nc")
    again = nt.open_run(tmp_path / "joined.nc")
    assert np.array_equal(again.directors, found.directors)
    further = [nt.simulate(BODY, t_end=4, start=run, **how) for run in (parts[-1], found)]
    assert np.array_equal(further[0].directors, further[1].directors)
    assert further[0].quaternion.values[0] == pytest.approx(parts[-1].quaternion.values[-1], abs=1e-15)


def test_different_loads_and_steps():
    first = nt.simulate(BODY, t_end=1, step=0.1, integrator="gauss", **START)
    push = nt.pulse((1, 0, 0), start=1, end=2)
    second = nt.simulate(BODY, t_end=2, step=0.25, start=first, integrator="split", load=push)
    found = nt.join_runs(first, second)
    assert found.time.values == pytest.approx([*np.arange(0, 1.05, 0.1), 1.25, 1.5, 1.75, 2], abs=1e-15)
    assert "step" not in found.attrs
    assert set(found.data_vars) == set(first.data_vars) & set(second.data_vars)
    at = nt.resample(found, [0.55, 1.8])
    assert at.kinetic_energy.values[0] == pytest.approx(first.kinetic_energy.values[0], rel=1e-13)
    body, how = STANDARD, {"step": 0.1, "integrator": "gauss"}
    events = {"events": lambda t, state: state.material_angular_velocity[1] - 1.99}
    one = nt.simulate(body, t_end=1, **how, **events, **START)
    other, without = (nt.simulate(body, t_end=5, start=one, **how, **more) for more in (events, {}))
    both, kept = nt.join_runs(one, other), nt.join_runs(one, without)
    assert both.t_events.values.tolist() == [*one.t_events.values, *other.t_events.values]
    assert both.t_events.size >= 1
    assert "event" not in kept.dims
    assert kept.time.values.tolist() == both.time.values.tolist()


def test_drifts_of_joined_runs(tmp_path):
    """Under the loads of all parts: a free part after a loaded one keeps K - A, not K."""
    push, brake = nt.pulse((1, 0, 0.5), start=0.5, end=1.5), nt.damping(0.4)
    parts = [nt.simulate(STANDARD, t_end=2, step=0.125, load=push, **START)]
    parts.append(nt.simulate(STANDARD, t_end=3, step=0.125, start=parts[0]))
    found = nt.drifts(nt.join_runs(*parts))
    assert list(found) == ["energy_balance", "orthonormality"]
    assert found["energy_balance"].relative < 1e-14
    assert np.ptp(parts[0].kinetic_energy.values) > 0.1
    parts.append(nt.simulate(STANDARD, t_end=5, step=0.125, start=parts[1], load=brake))
    nt.save_run(nt.join_runs(*parts), tmp_path / "joined.nc")
    shown = " ".join(nontwist("info", tmp_path / "joined.nc", COLUMNS="200").stdout.split())
    assert "0 s to 2 s: triangle pulse (1, 0, 0.5) N m along the directors, from 0.5 to 1.5 s" in shown
    assert "joined │ 3 runs, at t = 2, 3 s; integrator, error, run file are of the last" in shown
    assert "2 s to 3 s: none │ │ │ 3 s to 5 s: damping 0.4 N m s" in shown
    nested = nt.join_runs(nt.join_runs(*parts[:2]), parts[2])
    assert nt.drifts(nested)["energy_balance"].relative < 1e-14
    assert nested.attrs["joined"] == nt.join_runs(*parts).attrs["joined"]
    assert [part["t_end"] for part in json.loads(nested.attrs["joined"])] == [2, 3, 5]


def test_changing_potentials_and_wheels():
    def run(load, **how):
        return nt.simulate(STANDARD, **{"step": 0.125, "load": load, **how})

    soft, hard = (nt.spring(k, (0, 0, 1), (1, 0, 0)) for k in (3, 5))
    first = run(soft, t_end=2, **START)
    other, same, wheel = (run(load, start=first, t_end=4) for load in (hard, soft, nt.rotor((0, 0, 1), 2)))
    assert list(nt.drifts(other)) == ["total_energy", "vertical_momentum", "orthonormality"]
    assert list(nt.drifts(nt.join_runs(first, other))) == ["orthonormality"]
    assert nt.drifts(nt.join_runs(first, same))["total_energy"].relative < 1e-14
    assert list(nt.drifts(nt.join_runs(first, wheel))) == ["orthonormality"]


def test_resampling_of_joined_runs():
    push = nt.pulse((3, 0, 1), start=0.5, end=1.5)
    first = nt.simulate(BODY, t_end=1, step=0.125, store=4, load=push, order=4, **START)
    second = nt.simulate(BODY, t_end=3, step=0.1, start=first, store=5, order=8)
    times, whole = np.array([2.3, 0.7, 1.0, 0.2, 2.0, 1.2]), nt.join_runs(first, second)
    found = nt.resample(whole, times)
    assert found.attrs == whole.attrs | {"resampled": "between stored states"}
    assert found.time.values.tolist() == times.tolist()
    for part, chosen in ((first, times <= 1), (second, times > 1)):
        expected = nt.resample(part, times[chosen])
        for name in expected.data_vars:
            given = found[name].values[chosen]
            if name == "quaternion":
                given = given * np.sign((given * expected[name].values).sum(axis=1))[:, None]
            assert given == pytest.approx(expected[name].values, rel=1e-14, abs=1e-14), name
    for stored in ([0, 2, 4, 5, 6], [0, 3, 6]):
        again = nt.resample(whole.isel(time=stored), times)
        for name in ("directors", "material_angular_velocity"):
            assert again[name].values == pytest.approx(found[name].values, abs=1e-14), name
    for begin, at in ((1, [2, 0]), (1.2, [0])):
        late = whole.sel(time=slice(begin, 3))
        again = nt.resample(late, times[at]).directors.values
        assert again == pytest.approx(found.directors.values[at], abs=1e-12)
    for call in (lambda: nt.resample(late, times), lambda: nt.resample(whole, times, push)):
        with says():
            call()


def test_refusals():
    how = {"step": 0.1, **START}
    first, later, elsewhere = (nt.simulate(BODY, t_start=t, t_end=t + 1, **how) for t in (0, 2, 1))
    with warned("start-other-inertia"):
        other = nt.simulate(nt.nontwisting([3, 4, 5.5]), t_end=2, start=first, step=0.1)
    second = nt.simulate(BODY, t_end=2, start=first, step=0.1)
    unknown = first.assign(moment=first.moment.where(first.midtime > 0.1))
    for runs in (
        (),
        (first, other),
        (first, later),
        (first, 3),
        (first.isel(time=slice(0)),),
        (unknown,),
        (first.assign_attrs(load=7),),
        (first, elsewhere),
        (first, second, first),
    ):
        with says():
            nt.join_runs(*runs)
    assert nt.join_runs(first).drop_attrs().identical(first.drop_attrs())


BACKWARDS = slice(None, None, -1)


@pytest.mark.parametrize(
    "order",
    [
        lambda run: run.isel(director=[2, 0, 1], quat=[3, 0, 1, 2], axis=[1, 2, 0]),
        lambda run: run.transpose(*reversed(list(run.dims))),
        lambda run: run.isel(time=BACKWARDS),
        lambda run: run.isel(time=[1, 0, *range(2, 11)], midtime=BACKWARDS, axis=BACKWARDS).transpose("axis", ...),
    ],
)
@pytest.mark.filterwarnings("ignore:times are not in order")
def test_order_of_labels(order):
    """Directors, axes, components of quaternions, dims and times in another order are the same run."""
    load = nt.pulse((1, 2, 0), end=2)
    run = nt.simulate(STANDARD, t_end=1, step=0.1, material_angular_velocity=(1, 2, 3), load=load)
    other = order(run)
    for function in (
        lambda run: nt.point_position(run, (1, 2, 3)),
        lambda run: nt.simulate(STANDARD, t_end=2, step=0.1, start=run, load=load).directors,
        lambda run: nt.join_runs(run).load_work,
        lambda run: nt.resample(run, [0.23, 0.4]).directors,
        lambda run: nt.twist(run, axis="z").twist_angle,
        lambda run: nt.plot.energy_drift(run).lines[0].get_ydata(),
    ):
        assert np.array_equal(function(other), function(run))
    assert nt.drifts(other) == nt.drifts(run)


def test_balance_of_parts():
    """`isel` and `sel` leave all intervals to a part, and those of its states to one that is thinned."""
    how = {"t_end": 3, "step": 0.1, "material_angular_velocity": (1, 2, 3)}
    run = nt.simulate(STANDARD, load=nt.pulse((1, 2, 0), start=0, end=2), **how)
    joined = nt.join_runs(run.isel(time=slice(0, 11)), run.isel(time=slice(10, None)))
    assert np.array_equal(joined.load_work, run.load_work)
    for steps in (slice(3, 9), slice(None, None, 2), [0]):
        part = run.isel(time=steps)
        assert nt.drifts(part)["energy_balance"].relative < 1e-14
    assert nt.plot.energy_drift(run.isel(time=slice(None, None, 2))).lines[0].get_ydata().max() < 1e-14
    with pytest.raises(ValueError, match="states without the interval between them"):
        nt.drifts(run.isel(midtime=slice(None, None, 2)))
