"""`join_runs`: runs that continue one another are the run that was never divided."""

import json

import numpy as np
import pytest
import xarray

from nontwist import join_runs, nontwisting, open_run, pulse, resample, save_run, simulate, standard

BODY, START = nontwisting([3, 4, 5]), {"material_angular_velocity": (0.5, 2, 0)}
HOW = {"step": 0.125, "load": pulse((1, 0, 0), start=0.5, end=1.5)}


@pytest.mark.parametrize("integrator", ["gauss", "lie-midpoint", "energy-momentum", "split"])
def test_a_divided_run_is_that_of_one_piece(integrator, tmp_path):
    """Of gauss and split to round-off, of the others bit for bit."""
    how = HOW | {"integrator": integrator}
    whole = simulate(BODY, t_end=3, **how, **START)
    is_exact = integrator in ("lie-midpoint", "energy-momentum")
    parts = [simulate(BODY, t_end=1, **how, **START)]
    for end in (1.75, 3):
        parts.append(simulate(BODY, t_end=end, start=parts[-1], **how))
    found = join_runs(*parts)
    for name in whole.variables:
        if found[name].dtype.kind == "f":
            assert found[name].values == pytest.approx(whole[name].values, rel=0, abs=0 if is_exact else 1e-13), name
        assert found[name].dtype == whole[name].dtype
        assert found[name].dims == whole[name].dims
        assert found[name].attrs == whole[name].attrs
    assert found.attrs["step"] == whole.attrs["step"]
    assert [part["t_end"] for part in json.loads(found.attrs["joined"])] == [1, 1.75, 3]
    save_run(found, tmp_path / "joined.nc")
    again = open_run(tmp_path / "joined.nc")
    assert np.array_equal(again.directors, found.directors)
    further = [simulate(BODY, t_end=4, start=run, **how) for run in (parts[-1], found)]
    assert np.array_equal(further[0].directors, further[1].directors)


def test_other_loads_steps_and_events_are_joined():
    first = simulate(BODY, t_end=1, step=0.1, integrator="gauss", **START)
    second = simulate(BODY, t_end=2, step=0.25, start=first, integrator="split", load=pulse((1, 0, 0), start=1, end=2))
    found = join_runs(first, second)
    assert found.time.values == pytest.approx([*np.arange(0, 1.05, 0.1), 1.25, 1.5, 1.75, 2], abs=1e-15)
    assert "step" not in found.attrs
    assert set(found.data_vars) == set(first.data_vars) & set(second.data_vars)
    at = resample(found, [0.55, 1.8])
    assert at.kinetic_energy.values[0] == pytest.approx(first.kinetic_energy.values[0], rel=1e-13)
    events = {"events": lambda t, state: state.material_angular_velocity[1] - 1.99, "step": 0.1, "integrator": "gauss"}
    runs = [simulate(standard([3, 4, 5]), t_end=1, **events, **START)]
    runs.append(simulate(standard([3, 4, 5]), t_end=5, start=runs[0], **events))
    both = join_runs(*runs)
    assert both.t_events.values.tolist() == [*runs[0].t_events.values, *runs[1].t_events.values]
    assert both.t_events.size >= 1
    without = simulate(standard([3, 4, 5]), t_end=5, start=runs[0], step=0.1, integrator="gauss")
    kept = join_runs(runs[0], without)
    assert "event" not in kept.dims
    assert kept.time.values.tolist() == both.time.values.tolist()


def test_a_run_alone_is_itself():
    run = simulate(BODY, t_end=1, step=0.1, **START)
    assert join_runs(run).drop_attrs().identical(run.drop_attrs())


def test_what_does_not_fit_is_refused():
    first = simulate(BODY, t_end=1, step=0.1, **START)
    later = simulate(BODY, t_start=2, t_end=3, step=0.1, **START)
    elsewhere = simulate(BODY, t_start=1, t_end=2, step=0.1, **START)
    other = simulate(nontwisting([3, 4, 5.5]), t_end=2, start=first, step=0.1)
    unknown = first.assign(moment=first.moment.where(first.midtime > 0.1))
    for runs, message in (
        ((), "give the runs to join, in chronological order"),
        ((first, other), "run 1 is of another body than run 0"),
        ((first, later), "run 1 begins at t = 2 s, but run 0 ends at t = 1 s"),
        ((first, 3), "expected a run of nontwist.simulate as a Dataset, got 3"),
        ((first.isel(time=slice(0)),), "a run without states cannot be joined"),
        ((unknown,), r"moment\[0, 0\] = nan is not finite"),
        (
            (first.assign_attrs(load=7),),
            "the attribute load of the run is damaged: the JSON object must be .*, not int",
        ),
    ):
        with pytest.raises(ValueError, match=f"^{message}$"):
            join_runs(*runs)
    with pytest.raises(
        ValueError, match=r"^run 1 does not begin where run 0 ends: [\d.]+ rad and [\d.]+ rad/s apart; "
    ):
        join_runs(first, elsewhere)
    assert isinstance(join_runs(first), xarray.Dataset)
