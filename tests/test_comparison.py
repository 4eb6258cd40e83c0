"""compare: orders, errors against closed forms, what is kept, failures that stop nothing; its tables and its figure."""

import re

import numpy as np
import pytest
import xarray
from rich.console import Console
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, PAPER_J
from nontwist import plot
from nontwist.comparison import reference, summary, table
from nontwist.comparison.comparing import measured_orders
from nontwist.comparison.tables import times_to
from nontwist.integrators import Continuous, EnergyMomentum, LieMidpoint
from refusals import says

TILTED = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]
PUSH = nt.pulse((40, -20, 10), 0, 0.25, frame="space")


@pytest.fixture(scope="module")
def loaded():
    """A loaded Suslov body about a general axis; one step is too coarse, two integrators refuse."""
    with pytest.warns(UserWarning, match="the steps share only 2 times"):
        return nt.compare(
            nt.suslov(TILTED, [0.3, 0.2, 1]),
            t_end=0.5,
            angular_velocity=[4, -8, 0],
            project=True,
            load=PUSH,
            integrators=[("gauss", 2), ["gauss", 4], "split", "exact", Continuous(rtol=1e-7, atol=1e-9)],
            steps=[0.00625, 0.0125, 0.5, 0.025],
            repeats=1,
        )


@pytest.fixture(scope="module")
def free():
    return nt.compare(
        nt.nontwisting(PAPER_J),
        t_end=3,
        material_angular_velocity=[6, -18, 0],
        integrators=[LieMidpoint(2), EnergyMomentum(2), "exact"],
        steps=[0.05, 0.025],
        repeats=1,
    )


def test_orders(loaded):
    for order in (2, 4):
        measured = loaded.sel(integrator=f"gauss {order}")
        assert measured.attitude_order.values[2:] == pytest.approx([order] * 2, abs=0.2)
        assert measured.momentum_order.values[2:] == pytest.approx([order] * 2, abs=0.2)
    assert np.isnan(loaded.attitude_order[:, 0]).all()
    assert np.isnan(loaded.attitude_order.sel(integrator="continuous 1e-7")).all()


def test_an_order_needs_an_error_above_the_floor_that_decreases():
    errors = np.array([[4e-2, 1e-2, 1e-2, 1e-15], [1.0, np.nan, 0.25, 1.0]])
    orders = measured_orders(errors, np.array([0.4, 0.2, 0.1, 0.05]), np.full(4, 1e-13))
    assert orders == pytest.approx(np.array([[np.nan, 2, np.nan, np.nan], [np.nan] * 4]), nan_ok=True)


def test_a_failure_does_not_stop_other_runs(loaded):
    assert loaded.step.values.tolist() == [0.5, 0.025, 0.0125, 0.00625]
    coarse = loaded.sel(integrator="gauss 4", step=0.5)
    assert coarse.status == 1
    assert "rad in one step; try step <=" in str(coarse.message.values)
    for name, reason in (
        ("split 4", "split needs a constrained axis that is principal"),
        ("exact", "no closed-form solution"),
    ):
        refused = loaded.sel(integrator=name)
        assert (refused.status == -1).all()
        assert reason in str(refused.message[0].values)
        for number in ("attitude_error", "momentum_error_max", "run_time", "twist_defect"):
            assert np.isnan(refused[number]).all()
    done = loaded.sel(integrator=["gauss 2", "gauss 4"], step=[0.025, 0.0125, 0.00625])
    assert (done.status == 0).all()
    assert (done.message == "done").all()
    for number in ("attitude_error", "momentum_error_max", "run_time", "twist_defect", "drift"):
        assert np.isfinite(done[number]).all()


def test_integrators_without_a_step_are_repeated_at_every_step(loaded):
    free_of_steps = loaded.sel(integrator="continuous 1e-7")
    assert not free_of_steps.takes_steps
    assert len(set(free_of_steps.attitude_error_max.values)) == 1
    assert 1e-10 < free_of_steps.attitude_error_max[0] < 1e-5


def angle_error(directors, R):
    """2 sin(θ/2) of the rotation from one attitude to the other."""
    return 2 * np.sin((Rotation.from_matrix(np.swapaxes(directors, 1, 2)).inv() * R).magnitude() / 2)


@pytest.mark.parametrize("name", ["lie-midpoint 2", "energy-momentum 2"])
def test_errors_of_the_free_nontwisting_body(free, name):
    """It turns about a fixed axis, Λ = exp(t Ŵ), and W stays."""
    scheme = {"lie-midpoint 2": LieMidpoint(2), "energy-momentum 2": EnergyMomentum(2)}[name]
    for h in (0.05, 0.025):
        W = np.array([6.0, -18, 0])
        run = nt.integrate(nt.nontwisting(PAPER_J), t_end=3, step=h, material_angular_velocity=W, integrator=scheme)
        error = angle_error(run.directors, Rotation.from_rotvec(np.outer(run.time, W)))
        shared = error[:: round(0.05 / h)]
        reported = free.sel(integrator=name, step=h)
        assert reported.attitude_error == pytest.approx(error[-1], abs=1e-12)
        assert reported.attitude_error_max == pytest.approx(shared.max(), abs=1e-12)
        assert reported.momentum_error_max < 1e-11
        assert shared.max() > 1.03 * error[-1] or h < 0.05
    assert free.attrs["reference"] == "exact"
    assert free.attitude_below_bar.sel(integrator="exact").all()
    assert not free.attitude_below_bar.sel(integrator=name).any()
    assert 1e-16 < free.attitude_reference_error < 1e-12


def test_the_error_bar_of_a_closed_solution_covers_what_its_arithmetic_loses():
    """A pulse sets a body spinning about an axis of its own, as in the paper's case 2: 90 rad known to 2 eps · 90."""
    body, peak = nt.nontwisting(PAPER_J), np.array([-123.625, -53.75, 0])
    data = nt.compare(body, t_end=5, load=nt.pulse(peak), integrators=["exact"], steps=[5 / 21], repeats=1)
    turn = np.linalg.solve(PAPER_J, peak) / 2 * 4.5  # the impulse from the middle of the pulse on
    end = nt.integrate(body, times=[5.0], load=nt.pulse(peak), integrator="exact").directors[-1:]
    lost = angle_error(end, Rotation.from_rotvec([turn]))[0]
    assert data.attrs["reference"] == "exact"
    assert lost < data.attitude_reference_error
    expected = 2 * np.finfo(float).eps * np.linalg.norm(turn)
    assert data.attitude_reference_error == pytest.approx(expected, rel=0.2, abs=0)


def test_errors_of_the_free_symmetric_top():
    """Λ = exp(t M̂/A) exp(t s ê3), M = J W_0, s = (A - C)/A W_3; Π = Λᵀ M."""
    A, C, W = 2.0, 1.2, np.array([1.0, 2.0, 3.0])
    body, M = nt.standard([A, A, C]), np.array([A, A, C]) * W
    data = nt.compare(
        body, t_end=2, material_angular_velocity=W, integrators=[("lie-midpoint", 2)], steps=[0.02], repeats=1
    )
    run = nt.integrate(body, t_end=2, step=0.02, material_angular_velocity=W, integrator=LieMidpoint(2))
    t = run.time[:, None]
    R = Rotation.from_rotvec(t * M / A) * Rotation.from_rotvec(t * [0, 0, (A - C) / A * W[2]])
    assert data.attitude_error_max[0, 0] == pytest.approx(angle_error(run.directors, R).max(), abs=1e-12)
    w = np.cross(run.directors, run.director_velocities).sum(1) / 2
    Pi = np.einsum("nix,nx->ni", run.directors, w) * [A, A, C]
    gap = np.linalg.norm(Pi - R.inv().apply(M), axis=1)
    assert data.momentum_error[0, 0] == pytest.approx(gap[-1], abs=1e-12)
    assert data.momentum_error_max[0, 0] == pytest.approx(gap.max(), abs=1e-12)


def test_stepped_reference_against_the_closed_velocity_of_the_suslov_body():
    axis, start = np.array([0.0, 0, 1]), np.array([-4.0, 3, 0])
    how = {"t_end": 2, "material_angular_velocity": start}
    data = nt.compare(nt.suslov(TILTED, axis), integrators=[LieMidpoint(2)], steps=[0.1], repeats=1, **how)
    run = nt.integrate(nt.suslov(TILTED, axis), step=0.1, integrator=LieMidpoint(2), **how)
    w = np.cross(run.directors, run.director_velocities).sum(1) / 2
    W = np.einsum("nix,nx->ni", run.directors, w)
    gap = np.linalg.norm((W - nt.exact.suslov_velocity(TILTED, axis, start, run.time)) @ np.array(TILTED), axis=1)
    assert data.attrs["reference"].startswith("gauss 8")
    assert data.momentum_reference_error < 1e-12
    assert gap.max() > 1.5 * gap[-1]
    assert data.momentum_error[0, 0] == pytest.approx(gap[-1], abs=3e-12)
    assert data.momentum_error_max[0, 0] == pytest.approx(gap.max(), abs=3e-12)


def test_the_error_bar_counts_what_halved_steps_share():
    """A sleeping top turns by W T: two units of round-off of W, and half a unit of the time, are 2.5 units of W T."""
    top = nt.with_gravity(nt.standard([2, 2, 3]), 0.1, [0, 0, 1])
    data = nt.compare(
        top, t_end=2, material_angular_velocity=[0, 0, 90], steps=[0.05], integrators=["gauss"], repeats=1
    )
    assert data.attrs["reference"].startswith("gauss 8")
    assert data.attitude_reference_error == pytest.approx(2.5 * np.finfo(float).eps * 180, rel=0.05, abs=0)


def test_a_change_of_the_start_turns_the_body_as_well(monkeypatch):
    """An upright body at rest falls as cosh λt, λ² = m g l/J about the axis of the fall, and turns little about d3."""
    seen = []
    spy = "nontwist.comparison.comparing.reference"
    monkeypatch.setattr(spy, lambda *given: seen.append(reference.reference(*given)) or seen[0])
    nt.compare(nt.with_gravity(nt.standard([1, 2, 2]), 0.5, [0, 0, 1], [0, 0, -16]), t_end=3, steps=[0.05], repeats=1)
    expected = np.sqrt((1 + np.cosh(3 * np.sqrt(8)) ** 2 + np.cosh(3 * np.sqrt(4)) ** 2) / 3)
    assert seen[0].growth[0] == pytest.approx(expected, rel=0.3)  # the change is 64 units of round-off


def test_the_error_bar_trusts_a_scheme_only_as_far_as_an_independent_solution_confirms_it():
    assert reference.error_bar(own=1e-14, gap=1e-11, gap_of_other=1e-10) == 1e-14
    assert reference.error_bar(own=1e-14, gap=1e-11, gap_of_other=1e-12) == 1e-11
    assert reference.error_bar(own=1e-9, gap=1e-10, gap_of_other=1e-12) == 1e-9


def test_the_labels_and_the_defaults():
    everything = reference.chosen(None)
    gauss = [f"gauss {k}" for k in (2, 4, 6, 8, 12, 16)]
    stepping = [*gauss, "lie-midpoint 2", "energy-momentum 2", *(f"split {k}" for k in (2, 4, 6))]
    assert list(everything)[:11] == stepping
    assert list(everything)[-4:] == ["exact", "continuous 1e-6", "continuous 1e-9", "continuous 1e-12"]
    assert reference.label(Continuous("RK45", 1e-5, 1e-6, "director")) == "continuous RK45 1e-5 atol 1e-6 director"
    assert reference.label(Continuous("RK45", 1e-5, 1e-7), tolerance=False) == "continuous RK45"


def test_the_default_steps_halve_and_hold_the_kinks():
    found = reference.grids(None, 0.0, 2.0, 0.004, nt.pulse([1, 0, 0], 0.3, 0.7))
    N = np.array([grid.steps for grid in found.values()])
    assert (N[1:] == 2 * N[:-1]).all()
    first = next(iter(found.values()))
    assert first.borders == (0.0, 0.3, 0.5, 0.7, 2.0)
    assert first.numbers == (0, 3, 5, 7, 18)  # at most 32 * 0.004 s a step
    assert list(found) == pytest.approx(first.longest / 2.0 ** np.arange(len(N)))
    assert reference.shared_intervals(list(N)) == 18
    assert reference.shared_intervals([6000, 9000]) == 1000
    assert reference.stored_intervals(9000, 1000) == 9000
    assert reference.stored_intervals(30030, 10) == 4290


def test_the_default_leaves_out_integrators_that_refuse(monkeypatch):
    monkeypatch.setattr(Continuous, "compared", (1e-6,))
    data = nt.compare(BODIES["suslov"](), t_end=0.1, material_angular_velocity=[1, 2, 0], project=True, repeats=1)
    assert set(data.family.values) == {"lie-midpoint", "gauss", "energy-momentum", "continuous"}
    assert data.sizes["step"] == 7
    assert (data.status == 0).all()


@pytest.mark.parametrize(
    "options",
    [
        {"integrators": "split"},
        {"integrators": ["spilt"]},
        {"integrators": [("split", 3)]},
        {"integrators": [3]},
        {"integrators": ["split", ("split", 4)]},
        {"integrators": []},
        {"steps": []},
        {"steps": 0.1},
        {"steps": [0.3]},
        {"repeats": 0},
        {"t_end": -1},
    ],
)
def test_wrong_input(options):
    with says():
        nt.compare(nt.standard(PAPER_J), **{"t_end": 1, "material_angular_velocity": [1, 2, 3], **options})


def test_few_shared_times_are_warned_of():
    with pytest.warns(UserWarning, match="the steps share only 2 times"):
        data = nt.compare(
            nt.standard(PAPER_J), t_end=1, angular_velocity=[1, 2, 3], integrators=["split"], steps=[1 / 7, 0.125]
        )
    assert data.attrs["shared_times"] == 2


def test_a_comparison_is_saved_and_read(loaded, tmp_path):
    nt.save_run(loaded, tmp_path / "comparison.nc")
    xarray.testing.assert_identical(nt.open_run(tmp_path / "comparison.nc"), loaded)


def printed(what):
    console = Console(width=80)
    with console.capture() as capture:
        console.print(what)
    return capture.get()


def test_times_to_an_error_lie_on_the_line_of_the_logarithms():
    h = np.array([0.4, 0.2, 0.1])
    data = xarray.Dataset(
        {
            "attitude_error_max": (("integrator", "step"), [h**2, [np.nan] * 3]),
            "run_time": (("integrator", "step"), [1 / h, [np.nan] * 3]),
        },
        {"integrator": ["second", "failed"]},
    )
    assert times_to(data, 0.15**2) == {"second": pytest.approx(1 / 0.15)}
    assert times_to(data, 1.0) == {"second": pytest.approx(2.5)}
    assert times_to(data, 1e-3) == {}


def test_tables(loaded, free):
    choice, runs = printed(summary(loaded)), printed(table(loaded))
    lines = {
        line.split()[0] + line.split()[1]: line.split() for line in choice.splitlines() if line[:3] in ("gau", "spl")
    }
    assert lines["gauss4"][2:4] == ["4.0", "4.0"]
    assert re.search(r"^split 4 \[1\] +refused", choice, re.MULTILINE)
    assert "[1] split needs a constrained axis that is principal" in choice
    assert "Every drift within 1e-13: gauss 2, 4." in choice
    assert "failed" in runs
    assert "try step <=" in runs
    assert "<" in next(line for line in printed(table(free)).splitlines() if line.startswith("exact"))
    for text in (choice, runs, printed(summary(free)), printed(table(free))):
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text


def test_work_precision(loaded):
    axes = plot.work_precision(loaded)
    lines, (floor,) = axes.lines, axes.patches
    assert [line.get_label() for line in lines] == ["gauss 2", "gauss 4", "continuous"]
    good = loaded.sel(integrator="gauss 4").isel(step=slice(1, None))
    assert lines[1].get_xdata() == pytest.approx(1e3 * good.run_time.values)
    assert lines[1].get_ydata() == pytest.approx(good.attitude_error_max.values)
    assert len(lines[2].get_xdata()) == 1
    assert floor.get_y() + floor.get_height() == pytest.approx(float(loaded.attitude_reference_error), abs=0)
    assert lines[0].get_color() == lines[1].get_color() != lines[2].get_color()
    assert lines[0].get_marker() != lines[1].get_marker()
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["gauss", "continuous", "no steps", "order 2", "order 4"]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.figure.get_figwidth() == pytest.approx(3.5)


def test_errors_over_steps(loaded):
    """The slope is the order; integrators without steps, and each of their tolerances, are horizontal lines."""
    axes = plot.work_precision(loaded, against="steps")
    two, four, adaptive = axes.lines
    for line, name in ((two, "gauss 2"), (four, "gauss 4")):
        good = loaded.sel(integrator=name).isel(step=slice(1, None))
        assert line.get_xdata() == pytest.approx(good.step.values)
        assert line.get_ydata() == pytest.approx(good.attitude_error_max.values)
    slopes = [np.diff(np.log(line.get_ydata())) / np.diff(np.log(line.get_xdata())) for line in (two, four)]
    assert [slope[-1] for slope in slopes] == pytest.approx([2, 4], abs=0.1)
    assert adaptive.get_xdata() == pytest.approx([0.5, 0.00625, np.nan], nan_ok=True)
    assert len(set(adaptive.get_ydata())) == 1
    assert axes.get_xlabel() == "step (s)"
    assert [line.get_marker() for line in axes.lines] == ["o", "s", ""]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["gauss", "continuous", "order 2", "order 4"]
    (name,) = [text for text in axes.texts if text.get_text() == "continuous 1e-7"]
    assert name.xy == pytest.approx((0.00625, adaptive.get_ydata()[0]))
    with pytest.raises(ValueError, match=r"^against must be 'seconds' or 'steps', got 'work'$"):
        plot.work_precision(loaded, against="work")


JAGGED = np.arange(0, 2.01, 0.05)
TABLE = nt.body_moment(JAGGED, np.stack([np.sin(7 * JAGGED), np.cos(11 * JAGGED), np.sin(5 * JAGGED)], axis=1))
SPUN = {"t_end": 2, "material_angular_velocity": (0.5, 2, 0.1), "load": TABLE, "repeats": 1}


def test_steps_that_are_left_out_meet_the_kinks_of_a_table():
    """A moment every 0.05 s, 17 kinks in the coarsest of equal steps: each integrator has its order."""
    data = nt.compare(nt.standard([3, 4, 5]), integrators=[("lie-midpoint", 2), ("gauss", 4)], **SPUN)
    assert data.attrs["meets_kinks"] == 1
    measured = data.attitude_order.values
    last = [orders[np.isfinite(orders)][-1] for orders in measured]
    assert last == pytest.approx([2, 4], abs=0.15)
    assert data.step.values[0] <= 0.05 + 1e-12
    assert "Fastest to" in str(summary(data).caption)


def test_steps_that_miss_kinks_recommend_nothing():
    with pytest.warns(UserWarning, match="off the grid of step"):
        nt.integrate(nt.standard([3, 4, 5]), t_end=2, step=2 / 7, load=TABLE, material_angular_velocity=(0.5, 2, 0.1))
    data = nt.compare(nt.standard([3, 4, 5]), integrators=[("gauss", 4)], steps=[2 / 28, 2 / 56, 2 / 112], **SPUN)
    assert data.attrs["meets_kinks"] == 0
    shown = str(summary(data).caption)
    assert "The steps miss breakpoints of the load, so orders are spoilt and none is the fastest" in shown
    assert "Fastest to" not in shown
    assert not any("*" in cell for column in summary(data).columns for cell in column.cells)
    meets = nt.compare(nt.standard([3, 4, 5]), integrators=[("gauss", 4)], steps=[0.05, 0.025], **SPUN)
    assert meets.attrs["meets_kinks"] == 1


def test_the_step_for_an_error_lies_between_the_steps(free):
    table_of = summary(free, targets=[1e-6])
    headings = [str(column.header) for column in table_of.columns]
    cells = list(table_of.columns[headings.index("step\nfor\n1e-6")].cells)
    rows = list(table_of.columns[0].cells)
    steps = dict(zip(rows, cells, strict=True))
    found = times_to(free, 1e-6, "step")
    for name, step in found.items():
        runs = free.sel(integrator=name)
        if not bool(runs["takes_steps"]):
            assert steps[name] == "–"
            continue
        e, h = runs["attitude_error_max"].values, runs["step"].values
        k = int(np.argmax(e <= 1e-6))
        assert h[k] <= step <= (h[k - 1] if k else h[0])
        assert steps[name].lstrip(">") == f"{step:.2g}"


def test_a_step_that_meets_breakpoints_to_round_off_has_a_reference():
    """0.3 and 3 × 0.1 are one time, and not the ends of a step of 5.6e-17 s."""
    times = np.arange(9) / 10
    load = nt.body_moment(times, np.outer(np.sin(times), [1, 2, 3]) * (times < 0.8)[:, None])
    data = nt.compare(
        nt.standard([3, 4, 5]), t_end=2, load=load, angular_velocity=[1, 2, 3], steps=[0.1, 0.05], repeats=1
    )
    assert data.attrs["meets_kinks"] == 1
    assert data.attitude_error.sel(integrator="gauss 8").max() < 1e-9


def lags(t, z, directors, w):
    return (directors[0] - z) / 0.4


def follows(t, z, directors, w):
    return 0.1 * z[1], -0.2 * z[0], 0.1 * z[2]


@pytest.mark.parametrize(
    "load",
    [
        nt.memory_load(lags, follows, [0.0, 0.0, 0.0], compiled=True),
        nt.wheel("z", 0.1, 3, viscous=0.1),
        nt.wheel("z", 0.1, 3, coulomb=0.02),
    ],
)
def test_loads_that_gauss_alone_takes(load):
    """By default the integrators that take them; the reference is gauss, and no solver of SciPy."""
    how = {"t_end": 1, "material_angular_velocity": (0.5, 1.2, -0.4), "load": load, "repeats": 1}
    found = nt.compare(nt.standard([3, 4, 5]), **how)
    assert {name.split()[0] for name in found.integrator.values} == {"gauss"}
    assert found.attitude_order.sel(integrator="gauss 2")[-1] == pytest.approx(2, abs=0.1)
    assert found.attitude_error.sel(integrator="gauss 8")[-1] < 1e-12
    assert "DOP853" not in found.attrs["reference"]
