"""compare: orders, errors against closed forms, what is kept, failures that stop nothing; its tables and its figure."""

import re
from contextlib import nullcontext
from functools import partial

import numpy as np
import pytest
import xarray
from rich.console import Console
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, NONTWISTING, PAPER_J, STANDARD
from covering.problems import FULL as TILTED
from nontwist import plot
from nontwist.comparison import comparing, reference, second_quotient, summary, table
from nontwist.comparison.comparison_table import times_to
from nontwist.integrators import Continuous, EnergyMomentum, LieMidpoint
from refusals import says

PUSH = nt.pulse((40, -20, 10), 0, 0.25, frame="space")
ROUND_OFF = np.finfo(float).eps
compare = partial(nt.compare, repeats=1)


@pytest.fixture(scope="module")
def loaded():
    """A loaded Suslov body about a general axis; one step is too coarse, two integrators refuse."""
    with pytest.warns(UserWarning, match="the steps share only 2 times"):
        return compare(
            nt.suslov(TILTED, [0.3, 0.2, 1]),
            t_end=0.5,
            angular_velocity=[4, -8, 0],
            project=True,
            load=PUSH,
            integrators=[("gauss", 2), ["gauss", 4], "split", "exact", Continuous(rtol=1e-7, atol=1e-9)],
            steps=[0.00625, 0.0125, 0.5, 0.025],
        )


@pytest.fixture(scope="module")
def free():
    integrators, how = [LieMidpoint(2), EnergyMomentum(2), "exact"], {"material_angular_velocity": [6, -18, 0]}
    return compare(nt.nontwisting(PAPER_J), t_end=3, integrators=integrators, steps=[0.05, 0.025], **how)


def test_failure_stops_no_other_run(loaded):
    """Runs have their orders; those that fail or are refused have reasons; the one without steps is the same at all."""
    assert loaded.step.values.tolist() == [0.5, 0.025, 0.0125, 0.00625]
    assert loaded.attrs["shared_times"] == 2
    coarse = loaded.sel(integrator="gauss 4", step=0.5)
    assert coarse.status == 1
    assert "rad in one step; try step <=" in str(coarse.message.values)
    refused, done = loaded.sel(integrator=["split 4", "exact"]), loaded.sel(integrator=["gauss 2", "gauss 4"])
    done = done.isel(step=slice(1, None))
    for name, reason in (("split 4", "split needs a constrained axis that is principal"), ("exact", "no closed-form")):
        assert reason in str(refused.message.sel(integrator=name)[0].values)
    assert (refused.status == -1).all()
    assert (done.status == 0).all()
    assert (done.message == "done").all()
    for number in ("attitude_error", "momentum_error_max", "run_time", "twist_defect", "drift"):
        assert np.isnan(refused[number]).all()
        assert np.isfinite(done[number]).all()
    for order in (done.attitude_order, done.momentum_order):
        assert order.values[:, 1:] == pytest.approx(np.array([[2, 2], [4, 4]]), abs=0.2)
    without_steps = loaded.sel(integrator="continuous 1e-7")
    assert np.isnan(loaded.attitude_order[:, 0]).all()
    assert np.isnan(without_steps.attitude_order).all()
    assert not without_steps.takes_steps
    assert len(set(without_steps.attitude_error_max.values)) == 1
    assert 1e-10 < without_steps.attitude_error_max[0] < 1e-5


def test_order_needs_falling_errors():
    errors = np.array([[4e-2, 1e-2, 1e-2, 1e-15], [1.0, np.nan, 0.25, 0.25 / np.sqrt(2)]])
    orders = comparing.measured_orders(errors, np.array([0.4, 0.2, 0.1, 0.05]), np.full(4, 1e-13))
    assert orders == pytest.approx(np.array([[np.nan, 2, np.nan, np.nan], [np.nan] * 3 + [0.5]]), nan_ok=True)


def angle_error(directors, R):
    """2 sin(θ/2) of the rotation from one attitude to the other."""
    return 2 * np.sin((Rotation.from_matrix(np.swapaxes(directors, 1, 2)).inv() * R).magnitude() / 2)


def test_errors_of_free_nontwisting_body(free):
    """It turns about a fixed axis, Λ = exp(t Ŵ), and W stays."""
    W = np.array([6.0, -18, 0])
    for scheme, h in ((LieMidpoint(2), 0.05), (LieMidpoint(2), 0.025), (EnergyMomentum(2), 0.025)):
        run = nt.integrate(nt.nontwisting(PAPER_J), t_end=3, step=h, material_angular_velocity=W, integrator=scheme)
        error = angle_error(run.directors, Rotation.from_rotvec(np.outer(run.time, W)))
        shared = error[:: round(0.05 / h)]
        reported = free.sel(integrator=f"{scheme.name} 2", step=h)
        assert reported.attitude_error == pytest.approx(error[-1], abs=1e-12)
        assert reported.attitude_error_max == pytest.approx(shared.max(), abs=1e-12)
        assert reported.momentum_error_max < 1e-11
        assert shared.max() > 1.03 * error[-1] or h < 0.05
    assert free.attrs["reference"] == "exact"
    assert free.attitude_below_bar.all("step").values.tolist() == [False, False, True]
    assert not free.attitude_below_bar[:2].any()
    assert 1e-16 < free.attitude_reference_error < 1e-12


def test_suslov_by_a_stepped_reference():
    axis, start = np.array([0.0, 0, 1]), np.array([-4.0, 3, 0])
    body, how = nt.suslov(TILTED, axis), {"t_end": 2, "material_angular_velocity": start}
    data = compare(body, integrators=[LieMidpoint(2)], steps=[0.1], **how)
    run = nt.integrate(body, step=0.1, integrator=LieMidpoint(2), **how)
    w = np.cross(run.directors, run.director_velocities).sum(1) / 2
    W = np.einsum("nix,nx->ni", run.directors, w)
    gap = np.linalg.norm((W - nt.exact.suslov_velocity(TILTED, axis, start, run.time)) @ np.array(TILTED), axis=1)
    assert data.attrs["reference"] == "gauss 8 at h/8, beside h/4 and continuous DOP853"
    assert data.momentum_reference_error < 1e-12
    assert gap.max() > 1.5 * gap[-1]
    assert data.momentum_error[0, 0] == pytest.approx(gap[-1], abs=3e-12)
    assert data.momentum_error_max[0, 0] == pytest.approx(gap.max(), abs=3e-12)


def test_error_bars_of_arithmetic():
    """Of a closed solution, 90 rad known to 2 eps · 90; and what halved steps share, the round-off of W and of time."""
    body, push = nt.nontwisting(PAPER_J), nt.pulse(peak := np.array([-123.625, -53.75, 0]))  # as in the paper's case 2
    data = compare(body, t_end=5, load=push, integrators=["exact"], steps=[5 / 21])
    turn = np.linalg.solve(PAPER_J, peak) / 2 * 4.5  # the impulse from the middle of the pulse on
    end = nt.integrate(body, times=[5.0], load=push, integrator="exact").directors[-1:]
    assert data.attrs["reference"] == "exact"
    assert angle_error(end, Rotation.from_rotvec([turn]))[0] < data.attitude_reference_error
    assert data.attitude_reference_error == pytest.approx(2 * ROUND_OFF * np.linalg.norm(turn), rel=0.2, abs=0)
    top = nt.with_gravity(nt.standard([2, 2, 3]), 0.1, [0, 0, 1])  # sleeps: it turns by W T, known to 2.5 units
    how = {"t_end": 1, "material_angular_velocity": [0, 0, 90]}
    data = compare(top, steps=[0.05], integrators=["gauss"], **how)
    assert data.attrs["reference"].startswith("gauss 8")
    assert data.attitude_reference_error == pytest.approx(2.5 * ROUND_OFF * 90, rel=0.05, abs=0)
    for own, gap, gap_of_other, bar in ((1e-14, 1e-11, 1e-10, 1e-14), (1e-14, 1e-11, 1e-12, 1e-11), (3, 2, 1, 3)):
        assert reference.error_bar(own, gap, gap_of_other) == bar  # trusted as far as another solution confirms


def test_changed_start_turns_the_body(monkeypatch):
    """An upright body at rest falls as cosh λt, λ² = m g l/J about the axis of the fall, and turns little about d3."""
    seen = []
    spy = "nontwist.comparison.comparing.reference"
    monkeypatch.setattr(spy, lambda *given: seen.append(reference.reference(*given)) or seen[0])
    top = nt.with_gravity(nt.standard([1, 2, 2]), 0.5, [0, 0, 1], [0, 0, -16])
    compare(top, t_end=3, steps=[0.05], integrators=["gauss"])
    expected = np.sqrt((1 + np.cosh(3 * np.sqrt(8)) ** 2 + np.cosh(3 * np.sqrt(4)) ** 2) / 3)
    assert seen[0].growth[0] == pytest.approx(expected, rel=0.3)  # the change is 64 units of round-off


def test_the_labels_and_the_defaults(monkeypatch):
    everything = [*comparing.chosen(None)]
    orders = {"gauss": (2, 4, 6, 8, 12, 16), "lie-midpoint": (2,), "energy-momentum": (2,), "split": (2, 4, 6)}
    assert everything[:11] == [f"{name} {k}" for name, known in orders.items() for k in known]
    assert everything[-4:] == ["exact", "continuous 1e-6", "continuous 1e-9", "continuous 1e-12"]
    assert comparing.label(Continuous("RK45", 1e-5, 1e-6, "director")) == "continuous RK45 1e-5 atol 1e-6 director"
    assert comparing.label(Continuous("RK45", 1e-5, 1e-7), tolerance=False) == "continuous RK45"
    monkeypatch.setattr(Continuous, "compared", (1e-6,))
    data = compare(BODIES["suslov"](), t_end=0.1, material_angular_velocity=[1, 2, 0], project=True)
    assert set(data.family.values) == {"lie-midpoint", "gauss", "energy-momentum", "continuous"}  # those that accept it
    assert data.sizes["step"] == 7
    assert (data.status == 0).all()


def test_default_steps():
    load = nt.pulse([1, 0, 0], 0.3, 0.7)
    assert [len(comparing.grids(None, 0.0, 2.0, h, load)) for h in (0.004, 0.03, 0.2)] == [7, 5, 4]
    found = comparing.grids(None, 0.0, 2.0, 0.004, load)
    N = np.array([grid.steps for grid in found.values()])
    assert (N[1:] == 2 * N[:-1]).all()
    first = next(iter(found.values()))
    assert first.borders == (0.0, 0.3, 0.5, 0.7, 2.0)
    assert first.numbers == (0, 3, 5, 7, 18)  # at most 32 * 0.004 s a step
    assert list(found) == pytest.approx(first.longest / 2.0 ** np.arange(len(N)))
    assert [comparing.shared_intervals(each) for each in (list(N), [6000, 9000])] == [18, 1000]
    assert [comparing.stored_intervals(*each) for each in ((9000, 1000), (30030, 10))] == [9000, 4290]


def test_wrong_input_is_refused(loaded):
    for options in (
        *({"integrators": wrong} for wrong in ("split", ["spilt"], [("split", 3)], [3], ["split", ("split", 4)], [])),
        *({"steps": wrong} for wrong in ([], 0.1, [0.3])),
        {"repeats": 0},
        {"t_end": -1},
    ):
        with says():
            nt.compare(nt.standard(PAPER_J), **{"t_end": 1, "material_angular_velocity": [1, 2, 3], **options})
    with says():
        plot.work_precision(loaded, against="work")
    with says():
        summary(loaded, targets=[])


def test_long_comparisons_are_announced(monkeypatch):
    """One run of 20 steps and one of 10, each made and then timed."""
    monkeypatch.setattr(comparing, "notice", lambda cost, what: f"{what}: {cost.parts:g} {cost.unit}")
    with pytest.warns(UserWarning, match=r"^comparison: 60 steps$"):
        compare(STANDARD, t_end=1, integrators=["gauss", "exact"], steps=[0.1, 0.05], angular_velocity=(0, 1, 0))


def test_quotients_of_one_problem():
    """Runs of other bodies, loads and integrators have no common error."""
    runs = [nt.simulate(STANDARD, t_end=1, step=h, order=2, angular_velocity=(1, 2, 0)) for h in (0.1, 0.05, 0.025)]
    assert second_quotient(*runs).values[-1] == pytest.approx(4, abs=0.1)
    for changed in ({"system": NONTWISTING}, {"load": nt.damping(1)}, {"order": 4}):
        how = {"system": STANDARD, "t_end": 1, "step": 0.025, "order": 2, "angular_velocity": (1, 2, 0), **changed}
        with says():
            second_quotient(*runs[:2], nt.simulate(**how))


def test_saved_and_read(loaded, tmp_path):
    nt.save_run(loaded, tmp_path / "comparison.nc")
    xarray.testing.assert_identical(nt.open_run(tmp_path / "comparison.nc"), loaded)


def test_times_to_an_error(loaded):
    """Of runs with errors of the orders 2 and 4, and times as 1/h: all cells, counted by hand."""
    h, none = np.array([4.0, 2, 1]), [np.nan] * 3
    values = {
        "attitude_error_max": [1e-4 * h**2, 6.2e-8 * h**4, none, none, [2e-7] * 3],
        "run_time": [4e-3 / h, 8e-3 / h, none, none, [7e-3] * 3],
        "twist_defect": [h * 1e-14, h * 1e-12, none, none, [0.0] * 3],
    }
    drifts = np.outer([1, 30], [[1e-14] * 3, [2e-13, 4e-13, 9e-14], none, none, [3e-8] * 3]).reshape(2, 5, 3)
    data = loaded.isel(step=slice(1, None)).assign(drift=(("invariant", "integrator", "step"), drifts))
    data = data.assign({name: (("integrator", "step"), array) for name, array in values.items()})
    shown = [[*column.cells] for column in summary(data.assign_attrs(meets_kinks=1), targets=[1e-3, 2e-7]).columns]
    assert [cells[:3] + cells[4:] for cells in shown] == [
        ["gauss 2", "gauss 4", r"split 4 \[1]", "continuous 1e-7"],
        ["2.0", "4.0", "[red]refused[/]", "–"],
        ["2.0", "4.0", "", "–"],
        ["[bold green]1.26*[/]", "<2.00 ", "", "7.00 "],
        ["– ", "[bold green]5.97*[/]", "", "[bold green]7.00*[/]"],
        ["–", "0.0084", "", "–"],
        ["[green]1e-14[/]", "4e-13", "", "3e-8"],
        ["3e-13", "1e-11", "", "9e-7"],
        ["[green]4e-14[/]", "4e-12", "", "[green]0[/]"],
    ]
    assert times_to(data, 1.0) == pytest.approx({"gauss 2": 1e-3, "gauss 4": 2e-3, "continuous 1e-7": 7e-3})
    finest = [[*column.cells][7] for column in table(data).columns]
    assert finest[:3] + finest[5:] == ["  0.00625", "6.2e-8", "4.0", "[green]9e-14[/]", "3e-12", "1e-12", "8.00"]


def printed(what):
    console = Console(width=80)
    with console.capture() as capture:
        console.print(what)
    return capture.get()


def test_progress(monkeypatch):
    seen = list[float]()
    monkeypatch.setattr("nontwist.comparison.comparing.progress_bar", lambda *a: nullcontext(seen.append))
    body = NONTWISTING
    compare(body, t_end=1, integrators=["gauss", "exact"], steps=[0.1, 0.05], progress=True, angular_velocity=(0, 1, 0))
    assert seen == pytest.approx([0, 1 / 3, 2 / 3])


def test_tables(loaded, free):
    choice, runs, *others = map(printed, (summary(loaded), table(loaded), summary(free), table(free)))
    assert "[1] split needs a constrained axis that is principal" in choice
    assert "Every drift within 1e-13: gauss 2, 4." in choice
    assert "failed" in runs
    assert "try step <=" in runs
    assert re.search("^exact.*<", others[1], re.MULTILINE)
    for text in (choice, runs, *others):
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text


@pytest.mark.parametrize("changed", [{"step": slice(None, None, -1)}, ("step", ...)])
def test_comparisons_in_another_order(loaded, changed):
    """Of steps from fine to coarse, and of other dims, tables and figures are the same."""
    other = loaded.isel(changed) if isinstance(changed, dict) else loaded.transpose(*changed)
    for show in (summary, table):
        assert printed(show(other)) == printed(show(loaded))
    for against in ("seconds", "steps"):
        pairs = zip(*(plot.work_precision(one, against=against).lines for one in (loaded, other)), strict=True)
        for line, same in pairs:
            np.testing.assert_array_equal(same.get_xydata(), line.get_xydata())


def test_changed_comparisons_are_refused(loaded):
    for changed in (
        loaded.isel(integrator=0),
        loaded.sel(step=0.5),
        loaded.isel(invariant=[]),
        loaded.where(loaded.step < 0.1, drop=True),
        xarray.concat([loaded, loaded], "integrator", data_vars="minimal"),
    ):
        for show in (summary, table, *([plot.work_precision] if changed.sizes["invariant"] else [])):
            with says():
                show(changed)
    with says():
        plot.work_precision(loaded.sel(integrator=["split 4"]))


def test_work_precision(loaded):
    """Integrators without steps, each of their tolerances, are horizontal lines over steps."""
    axes, over_steps = plot.work_precision(loaded), plot.work_precision(loaded, against="steps")
    lines, (floor,) = axes.lines, axes.patches
    two, four, adaptive = over_steps.lines
    assert [line.get_label() for line in lines] == ["gauss 2", "gauss 4", "continuous"]
    for own, other, order in ((lines[0], two, 2), (lines[1], four, 4)):
        good = loaded.sel(integrator=f"gauss {order}").isel(step=slice(1, None))
        for line, x in ((own, 1e3 * good.run_time), (other, good.step)):
            assert line.get_xdata() == pytest.approx(x.values)
            assert line.get_ydata() == pytest.approx(good.attitude_error_max.values)
        slopes = np.diff(np.log(other.get_ydata())) / np.diff(np.log(other.get_xdata()))
        assert slopes[-1] == pytest.approx(order, abs=0.1)
    assert len(lines[2].get_xdata()) == 1
    assert adaptive.get_xdata() == pytest.approx([0.5, 0.00625, np.nan], nan_ok=True)
    assert len(set(adaptive.get_ydata())) == 1
    (name,) = (text for text in over_steps.texts if text.get_text() == "continuous 1e-7")
    assert name.xy == pytest.approx([0.00625, adaptive.get_ydata()[0]])
    bar = float(loaded.attitude_reference_error)
    assert floor.get_y() + floor.get_height() == pytest.approx(bar, abs=0)
    assert floor.get_y() == axes.get_ylim()[0] == pytest.approx(bar / 20, abs=0)
    assert lines[0].get_color() == lines[1].get_color() != lines[2].get_color()
    assert len(set(lines[0].get_color())) > 1  # no grey
    assert lines[0].get_marker() != lines[1].get_marker()
    assert [line.get_marker() for line in over_steps.lines] == ["o", "s", ""]
    for each, legend in (
        (axes, ["gauss", "continuous", "no steps", "order 2", "order 4"]),
        (over_steps, ["gauss", "continuous", "order 2", "order 4"]),
    ):
        assert [text.get_text() for text in each.get_legend().get_texts()] == legend
        assert each.get_xscale() == each.get_yscale() == "log"
    assert over_steps.get_xlabel() == "step (s)"
    assert axes.figure.get_figwidth() == pytest.approx(3.5)


def test_kinks_and_orders():
    """A moment every 0.05 s, 17 kinks in the coarsest of equal steps; those that are left out meet them."""
    t = np.arange(0, 2.01, 0.05)
    moments = nt.body_moment(t, np.stack([np.sin(7 * t), np.cos(11 * t), np.sin(5 * t)], axis=1))
    how = {"t_end": 2, "material_angular_velocity": (0.5, 2, 0.1), "load": moments}
    body, gauss = STANDARD, ("gauss", 4)
    data = compare(body, integrators=[("lie-midpoint", 2), gauss], **how)
    misses = compare(body, integrators=[gauss], steps=[2 / 28, 2 / 56, 2 / 112], **how)
    meets = compare(body, integrators=[gauss], steps=[0.05, 0.025], **how)
    assert [each.attrs["meets_kinks"] for each in (data, misses, meets)] == [1, 0, 1]
    assert [orders[np.isfinite(orders)][-1] for orders in data.attitude_order.values] == pytest.approx([2, 4], abs=0.15)
    assert data.step.values[0] <= 0.05 + 1e-12
    assert "Fastest to" in str(summary(data).caption)
    shown = str(summary(misses).caption)
    assert "The steps miss breakpoints of the load, so orders are spoilt and none is the fastest" in shown
    assert "Fastest to" not in shown
    assert not any("*" in cell for column in summary(misses).columns for cell in column.cells)


def test_breakpoints_to_round_off():
    """0.3 and 3 × 0.1 are one time, and not the ends of a step of 5.6e-17 s."""
    times = np.arange(9) / 10
    load = nt.body_moment(times, np.outer(np.sin(times), [1, 2, 3]) * (times < 0.8)[:, None])
    how = {"t_end": 2, "load": load, "angular_velocity": [1, 2, 3]}
    data = compare(STANDARD, steps=[0.1, 0.05], integrators=["gauss"], **how)
    assert data.attrs["meets_kinks"] == 1
    assert data.attitude_error.sel(integrator="gauss 8").max() < 1e-9


def lags(t, z, directors, w):
    return (directors[0] - z) / 0.4


def follows(t, z, directors, w):
    return 0.1 * z[1], -0.2 * z[0], 0.1 * z[2]


@pytest.mark.parametrize(
    ("load", "others"),
    [
        (nt.memory_load(lags, follows, [0.0, 0.0, 0.0], compiled=True), {"lie-midpoint", "energy-momentum"}),
        (nt.wheel("z", 0.1, 3, coulomb=0.02), {"lie-midpoint"}),
    ],
)
def test_loads_with_memory(load, others):
    """By default the integrators that take them; the reference is gauss, and no solver of SciPy."""
    how = {"t_end": 0.5, "material_angular_velocity": (0.5, 1.2, -0.4), "steps": [0.05, 0.025]}
    found = compare(STANDARD, load=load, **how)
    assert {name.split()[0] for name in found.integrator.values} == {"gauss"} | others
    assert found.attitude_order.sel(integrator="gauss 2")[-1] == pytest.approx(2, abs=0.1)
    assert found.attitude_error.sel(integrator="gauss 8")[-1] < 1e-12
    assert "DOP853" not in found.attrs["reference"]


@pytest.mark.parametrize(("seconds", "rounds"), [(0.02, 5), (0.06, 3), (0.2, 1), (0.4, 1)])
def test_long_calls_are_repeated_less(seconds, rounds, monkeypatch):
    """Of a clock that moves by what each of 40 calls takes: rounds begin as long as it is not past 5 s."""
    clock, calls = [0.0], []

    def call():
        clock[0] += seconds
        calls.append(clock[0])

    monkeypatch.setattr("nontwist.comparison.comparing.perf_counter", lambda: clock[0])
    best = comparing.shortest_times(dict.fromkeys(range(40), call), 5)
    assert len(calls) == 40 * rounds
    assert list(best.values()) == pytest.approx([seconds] * 40)
