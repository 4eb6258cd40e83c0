"""Artists and data, not pixels."""

import itertools
import re
import sys
from collections import Counter
from pathlib import Path
from unittest.mock import patch

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.text import Text
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import PAPER_J
from nontwist import plot
from nontwist.comparison import second_quotient
from nontwist.plot.journals import apart
from nontwist.plot.looks import LEAST, contrast, cycle, pale
from nontwist.plot.timelines import MOST
from nontwist.viewer.content import content
from nontwist.viewer.drawing import _unpacked, colours
from refusals import says

ABOVE = {"elevation": 90, "azimuth": -90}  # x to the right, y up, z towards the viewer
FREE = {"material_angular_velocity": [6, -18, 0]}


@pytest.fixture(scope="module")
def runs():
    return [
        nt.simulate(nt.nontwisting(PAPER_J), t_end=0.5, step=0.01 / k, integrator="lie-midpoint", **FREE)
        for k in (1, 2, 4)
    ]


@pytest.fixture(scope="module")
def two():
    load = nt.pulse((-61.8125, -26.875, 0), start=0, end=0.5)
    given = {"t_end": 1, "step": 0.01, "material_angular_velocity": [1.5, 4.5, 0], "load": load}
    bodies = {"non-twisting": nt.nontwisting(PAPER_J), "standard": nt.standard(PAPER_J)}
    return {name: nt.simulate(body, integrator="energy-momentum", **given) for name, body in bodies.items()}


def legends(axes):
    return [[text.get_text() for text in legend.get_texts()] for legend in axes.findobj(Legend)]


def named(axes, *names):
    """The lines with these labels."""
    return [next(line for line in axes.lines if line.get_label() == name) for name in names]


def path_of(axes, name="path"):
    """Near side and far side, start and end."""
    return named(axes, name, f"_{name}, far side", f"_start of {name}", f"_end of {name}")


def circle_of(axes):
    return named(axes, "great circle", "_great circle, far side")


def xy(*lines):
    points = np.concatenate([np.stack([line.get_xdata(), line.get_ydata()], axis=1) for line in lines])
    return points[np.isfinite(points).all(axis=1)]


@pytest.mark.parametrize(
    ("function", "options", "chosen", "wrong"),
    [
        ("momenta", {"frame": "space"}, lambda run: run.spatial_momentum, "frame must be 'space' or 'body', got 0"),
        ("momenta", {"frame": "body"}, lambda run: run.material_momentum, "frame must be 'space' or 'body', got 0"),
        ("directors", {"director": 2}, lambda run: run.directors[:, 1], "director must be 1, 2 or 3, got 0"),
    ],
)
def test_components_over_time(runs, function, options, chosen, wrong):
    draw = getattr(plot, function)
    lines = draw(runs[0], **options).lines
    assert len(lines) == 3
    for k, line in enumerate(lines):
        assert np.array_equal(line.get_ydata(), chosen(runs[0])[:, k])
    assert len({line.get_color() for line in lines}) == len({str(line._dash_pattern) for line in lines}) == 3
    with pytest.raises(ValueError, match=wrong):
        draw(runs[0], **dict.fromkeys(options, 0))


def test_labels_come_from_the_attributes(runs):
    axes = plot.momenta(runs[0])
    assert axes.get_ylabel() == "spatial momentum $π$ (kg m$^{2}$ s$^{-1}$)"
    assert axes.get_xlabel() == "time $t$ (s)"
    assert legends(plot.momenta(runs[0], frame="body")) == [["$Π_{1}$", "$Π_{2}$", "$Π_{3}$"]]
    run = runs[0].copy()
    run["kinetic_energy"].attrs = {"units": "eV", "symbol": "T_kin"}
    assert plot.energy(run).get_ylabel() == r"kinetic energy $T_{\mathrm{kin}}$ (eV)"


def test_runs_are_compared_by_line_style_components_by_colour(two):
    axes = plot.momenta(two)
    lines = axes.lines
    looks = np.array([(line.get_color(), str(line._dash_pattern)) for line in lines]).reshape(2, 3, 2)
    assert (looks[0, :, 0] == looks[1, :, 0]).all()
    assert len(set(looks[0, :, 0])) == 3
    assert {len(set(looks[k, :, 1])) for k in (0, 1)} == {1}
    assert looks[0, 0, 1] != looks[1, 0, 1]
    assert np.array_equal(lines[4].get_ydata(), two["standard"].spatial_momentum.sel(axis="y"))
    assert sorted(map(len, legends(axes))) == [2, 3]
    first, second = plot.energy(two).lines
    assert (first.get_color(), first.get_linestyle()) != (second.get_color(), second.get_linestyle())


def test_labels_lie_inside_the_figure_when_ticks_change_as_it_is_laid_out(tmp_path):
    """As of ten ticks where there was room for five: labels are placed beside those that are drawn."""
    (ax,) = plot.new_axes(height=2.45)
    with plot.style():
        ax.plot([1e-3, 1], [9.422865739818295, -9.331086372293814])
        ax.set(xlabel="start.angular_velocity.body.2 (rad s$^{-1}$)", xscale="log")
        ax.set_ylabel("material angular velocity $W_{1}$ (rad s$^{-1}$)")
    plot.save(ax, tmp_path / "a.png")
    assert ax.yaxis.label.get_window_extent().x0 >= 0


def test_legends_lie_beside_the_axes_and_inside_the_figure(two):
    several = {f"{name} body, {k}": two["non-twisting"] for name in ("one", "another") for k in "ab"}
    for draw in (plot.multipliers, plot.momenta, plot.path, plot.polhode):
        axes = draw(several)
        figure = axes.figure
        figure.canvas.draw()
        boxes = [legend.get_window_extent() for legend in axes.findobj(Legend)]
        inside = figure.bbox.padded(1)
        assert len(boxes) > 1
        assert all(inside.contains(*box.p0) and inside.contains(*box.p1) for box in boxes)
        assert not any(a.overlaps(b) for a, b in itertools.combinations([axes.bbox.padded(-2), *boxes], 2))


def test_figures_for_slides_are_as_the_gallery_says(two, tmp_path, monkeypatch):
    """Letters of 16 pt, the shape of a slide, and rows of the legend that do not overlap."""
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[1] / "docs" / "gallery.md").read_text(encoding="utf-8")
    code = page.partition("## Figures for slides")[2].partition("```python\n")[2].partition("```")[0]
    exec(code, names := {"plot": plot, "runs": two})
    axes = names["ax"]
    assert {text.get_fontsize() for text in axes.findobj(Text) if text.get_text()} == {16.0}
    assert axes.figure.get_figwidth() / axes.figure.get_figheight() == pytest.approx(16 / 9, rel=2e-3)
    first, second = (legend.get_window_extent() for legend in axes.findobj(Legend))
    assert not first.overlaps(second)
    assert Path("slide.png").exists()


def test_the_exponent_of_an_axis_and_the_legend_do_not_overlap():
    small = nt.with_gravity(nt.standard([1e-8, 2e-8, 2.5e-8]), 1e-6, (0, 0, 0.01))
    axes = plot.energy(nt.simulate(small, t_end=5, angular_velocity=(1, 2, 0)))
    axes.figure.canvas.draw()
    (legend,), exponent = axes.findobj(Legend), axes.yaxis.get_offset_text()
    assert exponent.get_text()
    assert not legend.get_window_extent().overlaps(exponent.get_window_extent())
    assert legend.get_window_extent().y1 <= axes.figure.bbox.y1 + 1


def test_what_is_no_run_is_refused(runs):
    sentence, run = "give a run (a Dataset), or several as {'a label': run, 'another': run2}; got ", runs[0]
    for wrong, told in (
        ([run], f"{sentence}list"),
        ({}, f"{sentence}dict"),
        ({"a": run, "b": 1}, f"{sentence}{{'a': 'Dataset', 'b': 'int'}}"),
        (nt.integrate(nt.nontwisting(PAPER_J), t_end=0.1, step=0.05), "got Trajectory"),
        ({"many": run.expand_dims(member=2)}, "the run 'many' is an ensemble: choose a member"),
        (run[["quaternion"]], "the run has no spatial_momentum: it has quaternion"),
        ({f"run {k}": run for k in range(9)}, "9 curves cannot be distinguished, at most 8"),
    ):
        with pytest.raises(ValueError, match=re.escape(told)):
            plot.momenta(wrong)


def test_energy_shows_the_potential_where_there_is_one(runs):
    assert len(plot.energy(runs[0]).lines) == 1
    top = nt.simulate(nt.heavy_top([2, 2, 1], 1, [0, 0, 0.5]), t_end=0.1, step=0.01, angular_velocity=[1, 0, 0])
    axes = plot.energy(top)
    assert len(axes.lines) == 3
    assert np.ptp(axes.lines[2].get_ydata()) < 1e-12
    assert axes.get_ylabel() == "change of energy (J)"  # of 0.1 s


def test_energy_drift_is_the_balance_with_the_work_of_the_load(two):
    run = two["standard"]
    assert np.ptp(run.kinetic_energy.values) > 10
    first, second, round_off = plot.energy_drift(two).lines
    assert max(first.get_ydata().max(), second.get_ydata().max()) < 1e-14
    assert first.get_ydata().min() == round_off.get_ydata()[0] == np.finfo(float).eps
    spoilt = run.assign(kinetic_energy=run.kinetic_energy.copy())
    spoilt["kinetic_energy"][50:] += 1e-6 * float(run.kinetic_energy.max())
    drift = plot.energy_drift(spoilt).lines[0].get_ydata()
    assert drift[50:] == pytest.approx(1e-6, rel=1e-5)
    assert drift[:50].max() < 1e-14
    with pytest.raises(ValueError, match="the run has no load_work: draw the run before it is resampled"):
        plot.energy_drift(nt.resample(run, run.time))


def test_orthonormality_of_a_long_run_keeps_its_largest_values(runs):
    run = runs[0][["orthonormality_defect"]].isel(time=np.zeros(5001, int)).assign_coords(time=np.arange(5001.0))
    run["orthonormality_defect"][:] = np.arange(5001) % 1000 * 1e-9
    curve = plot.orthonormality(run).lines[0]
    assert curve.get_xdata().size == 200
    assert curve.get_ydata().max() == 999e-9
    assert curve.axes.get_yscale() == "log"


def test_long_curves_keep_their_extremes(runs):
    t = np.linspace(0, 1, 100_000)
    run = runs[0][["directors"]].isel(time=np.zeros(t.size, int)).assign_coords(time=t)
    run["directors"][:, 2, 0] = np.sin(2000 * t)
    line = plot.directors(run).lines[0]
    assert line.get_xdata().size <= MOST + 2
    assert line.get_xdata()[[0, -1]].tolist() == [0, 1]
    assert np.ptp(line.get_ydata()) == pytest.approx(2, abs=1e-3)


def test_second_quotient_with_its_limit(runs):
    quotient = second_quotient(*runs)
    spike = quotient.copy()
    spike[7] = 5.5
    for each in (quotient, spike):
        axes = plot.second_quotient(each)
        curve, limit = axes.lines
        assert limit.get_ydata()[0] == 4
        low, high = axes.get_ylim()
        assert low < curve.get_ydata().min() < curve.get_ydata().max() < high
    assert legends(plot.second_quotient({"a": quotient, "b": quotient})) == [["a", "b"]]
    with pytest.raises(ValueError, match="pass the result of nontwist"):
        plot.second_quotient(runs[0])


def test_path_hides_what_lies_behind(runs):
    near, far, start, end = path_of(plot.path(runs[0], elevation=25, azimuth=35))
    seen = np.isfinite(near.get_xdata())
    hidden = np.isfinite(far.get_xdata())
    assert contrast(far.get_color()) < contrast(near.get_color())
    assert far.get_linewidth() < near.get_linewidth()
    assert (seen | hidden).all()
    assert (seen & hidden).sum() < 0.1 * seen.size
    assert 0.3 < hidden.mean() < 0.7
    assert np.linalg.norm(xy(near), axis=1).max() <= 1 + 1e-12
    assert start.get_marker() != end.get_marker()


def test_path_seen_from_above_is_its_projection(two):
    near, far, start, end = path_of(plot.path(two["standard"], **ABOVE))
    d = two["standard"].directors.sel(director=3).values
    assert xy(start, end) == pytest.approx(d[[0, -1], :2], abs=1e-12)
    middle = (d[1:] + d[:-1])[:, 2] > 0.1
    for line, points in ((near, d[1:][middle]), (far, d[1:][(d[1:] + d[:-1])[:, 2] < -0.1])):
        gaps = np.linalg.norm(points[:, None, :2] - xy(line)[None], axis=2).min(axis=1)
        assert gaps.max() < np.radians(1)


def test_the_grid_of_the_globe_is_on_the_sphere(two):
    """From above, parallels are circles of the radius cos φ, and meridians are straight."""
    lines = plot.path(two["standard"], **ABOVE).lines
    parallels, meridians = (
        xy(*(line for line in lines if line.get_label().startswith(name))) for name in ("_parallel", "_meridian")
    )
    assert set(np.hypot(*parallels.T).round(9)) == set(np.cos(np.radians([0, 30, 60])).round(9))
    x, y = meridians[np.hypot(*meridians.T) > 0.1].T
    assert np.hypot(x, y).max() == pytest.approx(1, abs=1e-9)
    assert set(np.degrees(np.arctan2(y, x)).round(6) % 180) == {0, 30, 60, 90, 120, 150}


@pytest.mark.parametrize("colour", ["#0072b2", "0.3", "#d55e00"])
def test_a_pale_colour_is_as_near_to_white_as_may_be(colour):
    """On the line from white to the colour, in steps of a twentieth."""
    given, found = 1 - np.array(to_rgb(colour)), 1 - np.array(pale(colour))
    share = found.sum() / given.sum()
    assert found == pytest.approx(share * given)
    assert contrast(1 - found) >= LEAST > contrast(1 - (share - 0.05) * given)


def test_great_circle_is_where_a_free_body_stays(runs, two):
    """After the load of case 3 ends at 0.5 s the non-twisting body stays on it, the standard body leaves it."""

    def gaps(run, times):
        circle = xy(*circle_of(plot.path(run, great_circle=True, **ABOVE)))
        d = run.directors.sel(director=3, time=times).values
        return np.linalg.norm(d[:, None, :2] - circle[None], axis=2).min(axis=1)

    assert gaps(runs[0], slice(None)).max() < np.radians(1)
    assert gaps(two["non-twisting"], slice(0.5, None)).max() < np.radians(1)
    assert gaps(two["non-twisting"], slice(0, 0.3)).max() > 0.1
    assert gaps(two["standard"], slice(0.5, None)).max() > np.radians(4)


def test_triads_are_the_other_directors(runs):
    axes = plot.path(runs[0], triads=9, **ABOVE)
    d1, d1_far, d2, d2_far = named(axes, *(name for k in "12" for name in (f"$d_{k}$", f"_$d_{k}$, far side")))
    q = runs[0].directors.values
    for k, (near, far) in enumerate(((d1, d1_far), (d2, d2_far))):
        foot, tip = xy(near, far).reshape(9, 2, 2).transpose(1, 0, 2)
        which = [np.argmin(np.linalg.norm(q[:, 2, :2] - f, axis=1)) for f in foot]
        sticks = np.linalg.norm(tip - foot - 0.2 * q[which, k, :2], axis=1)
        assert np.median(sticks) < 1e-12
    assert np.isfinite(d1.get_xdata()).any()
    assert np.isfinite(d1_far.get_xdata()).any()
    assert legends(axes) == [["start", "end", "$d_1$", "$d_2$"]]


def test_the_viewer_stands_where_a_short_path_is_seen():
    backwards = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # d3 = -x
    run = nt.simulate(nt.standard([1, 2, 3]), t_end=0.1, step=0.01, rotation=backwards, angular_velocity=[1, 2, 0])
    near, far, *_ = path_of(plot.path(run))
    assert np.isfinite(near.get_xdata()).all()
    assert not np.isfinite(far.get_xdata()).any()


def test_twist_angle_of_long_steps_is_that_of_short_ones():
    """Of states half a radian apart a frame would be transported 0.14 rad wrong."""
    free, start = nt.standard([3, 4, 5]), {"t_end": 10, "material_angular_velocity": (1, 2, 0.5)}
    few, many = nt.simulate(free, tolerance=1e-9, **start), nt.simulate(free, step=0.005, **start)
    assert few.sizes["time"] < 40
    assert abs(nt.twist(few).twist_angle[-1] - nt.twist(many).twist_angle[-1]) > 0.1
    message = (
        f"the run has {few.sizes['time']} states, between which the body turns by up to 0.98 rad: its curves are drawn "
        "as polygons; draw resample(run, times), or run it with times="
    )
    with pytest.warns(UserWarning, match=f"^{re.escape(message)}$"):
        drawn = [[line.get_ydata()[-1] for line in plot.twist_angle(run, swing=True).lines[:3]] for run in (few, many)]
    plot.twist_angle(nt.resample(few, np.linspace(0, 10, 200)))  # without a warning
    assert drawn[0] == pytest.approx(drawn[1], abs=1e-7)
    shown = [[_unpacked(content(run)[key])[-1] for key in ("twist", "swing", "area")] for run in (few, many)]
    assert shown[0] == pytest.approx(shown[1], abs=1e-6)
    body = nt.suslov([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]], (0, 0, 1))
    held = nt.simulate(body, tolerance=1e-9, project=True, **start)
    part = held.sel(time=slice(1, 9))  # whose intervals are those of the whole run
    with pytest.warns(UserWarning, match=r"^the run has \d\d states, .* its curves are drawn as polygons; "):
        of_held, of_part = (plot.twist_angle(run).lines[0].get_ydata() for run in (held, part))
    assert abs(of_held).max() < 1e-14
    assert len(of_part) == part.sizes["time"]


def test_twist_angle_of_a_spin_and_of_bodies_that_may_not_spin():
    spin = nt.simulate(nt.standard([2, 2, 1]), t_end=4, step=0.02, material_angular_velocity=[0, 0, 3], order=8)
    line = plot.twist_angle(spin).lines[0]
    assert line.get_ydata() == pytest.approx(3 * spin.time.values, abs=1e-10)
    assert plot.twist_angle(spin, degrees=True).lines[0].get_ydata()[-1] == pytest.approx(np.degrees(12))
    _, tau, gap, _ = plot.twist_angle(spin, swing=True).lines
    assert np.isnan(tau.get_ydata()).sum() == 2  # the jumps of a wrapped angle that reaches 12
    assert abs(gap.get_ydata()).max() < 1e-10
    body = nt.suslov([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]], [1, 0, 0.2])
    tilted = nt.simulate(body, t_end=4, step=0.01, material_angular_velocity=[0.2, 3, -1])
    axes = plot.twist_angle(tilted)
    assert abs(axes.lines[0].get_ydata()).max() < 1e-5
    assert np.ptp(axes.get_ylim()) > 0.01


def test_curves_of_many_swings_are_laid_on_each_other():
    """33 swings of 60°: ψ is a thin line on the wide one of τ, whose dashes would merge; two runs look likewise."""

    def recorded(periods):
        t = np.linspace(0, 9 * periods, 200 * periods + 1)
        turn, lean = np.sin(2 * np.pi * t / 9), 0.02 * np.sin(2 * np.pi * t / 9 + 1)
        swing = Rotation.from_euler("YX", np.stack([lean, 0.5 * turn], axis=1))
        return nt.twist(swing * Rotation.from_rotvec(np.outer(turn, [0, 0, 1])), t)

    long, short = recorded(33), recorded(5)
    for axes in (plot.twist_angle(long, swing=True), plot.twist_angle({"true": long, "markers": long})):
        thin, wide = axes.lines[:2]
        assert wide.get_linewidth() >= 2 * thin.get_linewidth()
        assert thin.get_zorder() > wide.get_zorder()
        assert {line.get_linestyle() for line in (thin, wide)} == {"-"}
        widths = [line.get_linewidth() for line in axes.findobj(Legend)[0].get_lines()]
        assert widths[:2] == [thin.get_linewidth(), wide.get_linewidth()]
    with plot.style():
        first, second = cycle()[:2]
    assert (thin.get_color(), wide.get_color()) == (first["color"], second["color"])
    assert {line.get_linewidth() for line in plot.twist_angle(long, swing=True, lw=0.9).lines[:3]} == {0.9}
    axes = plot.twist_angle(short, swing=True)
    assert {line.get_linewidth() for line in axes.lines[:3]} == {1.1}
    assert axes.lines[1].get_linestyle() == "--"


def test_reaction_moment_is_the_published_one(runs, two):
    axes = plot.reaction_moment(nt.simulate(nt.nontwisting(PAPER_J), t_end=0.1, step=1e-3, order=8, **FREE))
    assert axes.lines[0].get_ydata() == pytest.approx(-66.857142857, rel=1e-9)
    assert axes.get_ylabel() == "reaction moment $-μ$ (N m)"
    assert np.ptp(axes.get_ylim()) > 1  # a constant looks like one
    with says():
        plot.reaction_moment(two)


def test_multipliers(runs, two):
    axes = plot.multipliers(two["non-twisting"])
    lines = axes.lines
    names = [name for row in legends(axes) for name in row]
    assert sorted(names) == sorted([f"$λ_{{{k}}}$" for k in ("11", "22", "33", "23", "13", "12")] + ["$μ$"])
    assert len({(line.get_color(), str(line._dash_pattern)) for line in lines}) == 7
    assert np.array_equal(lines[-1].get_ydata(), two["non-twisting"].multipliers.sel(constraint="nh"))
    assert len(plot.multipliers(two).lines) == 7 + 6
    assert plot.multipliers(runs[0]).get_ylabel() == "multiplier $μ$ (N m)"
    free = nt.simulate(nt.standard(PAPER_J), t_end=0.1, step=0.01, **FREE)
    with pytest.raises(ValueError, match="the run has no multipliers: the integrator 'energy-momentum' gives"):
        plot.multipliers(free)


def test_polhode_lies_on_the_inertia_ellipsoid(two):
    """One of a symmetric top is a circle, without a separatrix; a body at rest has none."""
    J = np.array([[1.2, 0.1, 0], [0.1, 2, 0.2], [0, 0.2, 3]])
    run = nt.simulate(nt.standard(J), t_end=4, step=0.02, material_angular_velocity=[0.5, 2, 1])
    axes = plot.polhode(run, **ABOVE)
    near, far, start, end = path_of(axes, "polhode")
    W = run.material_angular_velocity.values
    x = W / np.sqrt(np.einsum("ki,ij,kj->k", W, J, W))[:, None] * np.sqrt(np.linalg.eigvalsh(J)[0])
    assert xy(start, end) == pytest.approx(x[[0, -1], :2], abs=1e-12)
    gaps = np.linalg.norm(x[:, None, :2] - xy(near, far)[None], axis=2).min(axis=1)
    assert gaps.max() < np.radians(1)
    assert legends(axes) == [["start", "end", "separatrix"]]
    top = nt.simulate(nt.standard([2, 2, 1]), t_end=4, step=0.02, material_angular_velocity=[0.5, 2, 1])
    axes = plot.polhode(top, **ABOVE)
    assert np.ptp(np.linalg.norm(xy(*named(axes, "polhode")), axis=1)) < 1e-3
    assert legends(axes) == [["start", "end"]]
    pushed = nt.simulate(nt.nontwisting(PAPER_J), t_end=0.2, step=0.01, load=nt.pulse((-1, -2, 0), start=0, end=0.1))
    assert np.isfinite(xy(*path_of(plot.polhode(pushed), "polhode"))).all()
    with pytest.raises(ValueError, match="the run is at rest"):
        plot.polhode(nt.simulate(nt.standard(PAPER_J), t_end=0.1, step=0.01))
    with pytest.raises(ValueError, match="one ellipsoid needs one inertia, but 'standard' and 'other' have different"):
        plot.polhode({"standard": two["standard"], "other": run})
    for moments in ([3, 4, 5], [2, 4, 5], [1, 5, 5.5]):  # the ellipsoid fills its figure
        axes = plot.polhode(nt.simulate(nt.standard(moments), t_end=3, material_angular_velocity=(1.2, 2.5, 0.1)))
        axes.figure.canvas.draw()
        outline, rows = axes.patches[0].get_window_extent(), axes.get_legend().get_window_extent().height
        whole = axes.figure.bbox.width * (axes.figure.bbox.height - rows)
        assert outline.width * outline.height > 0.5 * whole


SQUARE = [(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)]
FUNCTIONS = sorted(set(plot.__all__) - {"new_axes", "save", "style", "work_precision"})


def draw(name, runs, two, *more, **properties):
    """One figure of every function."""
    given = {
        "tube": lambda: (SQUARE,),
        "ribbon": lambda: (SQUARE, [(0, 0, 1)] * 4),
        "second_quotient": lambda: (second_quotient(*runs),),
    }
    return getattr(plot, name)(*given.get(name, lambda: (two["non-twisting"],))(), *more, **properties)


def test_given_axes_are_used_and_nothing_global_changes(runs, two):
    before = dict(matplotlib.rcParams)
    for name in FUNCTIONS:
        axes = plot.new_axes(columns=2)[0]
        assert draw(name, runs, two, axes) is axes
        assert axes.has_data()
    assert dict(matplotlib.rcParams) == before


def test_properties_that_a_caller_gives_count_for_curves_and_legend(runs, two):
    for name in FUNCTIONS:
        axes = draw(name, runs, two, alpha=0.4, lw=3)
        drawn = axes.collections if name in ("tube", "ribbon") else axes.lines
        assert any((one.get_alpha(), np.max(one.get_linewidth())) == (0.4, 3) for one in drawn), name
        kind = "PolyCollection" if name in ("tube", "ribbon") else "Line2D"
        told = f"^plot.{name} accepts its own arguments and properties of matplotlib's {kind}; got glow: "
        with pytest.raises(ValueError, match=told):
            draw(name, runs, two, glow=1)
    axes = plot.momenta(two, color="red")
    assert {line.get_color() for line in axes.lines} == {"red"}
    for legend in axes.findobj(Legend):
        assert {line.get_color() for line in legend.get_lines()} == {"red"}


def test_settings_of_the_user_win(two):
    users = {"font.size": 12, "lines.linewidth": 3, "axes.prop_cycle": matplotlib.cycler(color=["#111111", "#222222"])}
    with matplotlib.rc_context(users):
        axes = plot.momenta(two["standard"])
        assert axes.xaxis.label.get_size() == 12
        assert [line.get_color() for line in axes.lines] == ["#111111", "#222222", "#111111"]
        assert len({str(line._dash_pattern) for line in axes.lines}) == 3
        assert {line.get_linewidth() for line in axes.lines} == {3}
    with plot.style(), matplotlib.rc_context({"lines.linewidth": 2}):
        assert {line.get_linewidth() for line in plot.momenta(two["standard"]).lines} == {2}


@pytest.mark.parametrize(("journal", "one", "two_wide"), [("springer", 84, 174), ("elsevier", 90, 190)])
def test_journals(runs, journal, one, two_wide):
    with plot.style(journal):
        axes = plot.path(runs[0])
        wide = plot.new_axes(columns=2)[0]
    assert 25.4 * axes.figure.get_size_inches() == pytest.approx([one, one])
    assert 25.4 * wide.figure.get_figwidth() == pytest.approx(two_wide)
    assert axes.get_legend().get_texts()[0].get_family() == ["sans-serif"]
    assert plot.energy(runs[0]).get_ylabel()
    assert plot.new_axes()[0].figure.get_figwidth() == pytest.approx(3.5)
    wrong = plot.style("nature")
    with pytest.raises(ValueError, match="journal must be 'nontwist', 'springer', 'elsevier', got 'nature'"), wrong:
        pass


def ground_of(colour, alpha):
    """A colour on white."""
    return tuple(1 - (alpha if alpha is not None else 1) * (1 - x) for x in matplotlib.colors.to_rgb(colour))


def test_letters_and_lines_can_be_seen_at_print_size(runs, two):
    """Letters 8 pt high, 4.5 times as dark as the ground; lines that are data or explain it 3 times (WCAG)."""
    with plot.style():
        several = plot.new_axes(columns=2, panels=2)
    figures = [draw(name, runs, two) for name in FUNCTIONS] + [plot.momenta(two, several[0])]
    figures += [plot.path(two, triads=5, great_circle=True), several[1]]
    guides = ("_meridian", "_parallel", "_level", "_child")  # what only helps the eye
    for axes in figures:
        axes.figure.canvas.draw()
        legend_texts = [text for legend in axes.findobj(Legend) for text in legend.get_texts()]
        ticks = [axes.xaxis, axes.yaxis] if axes.axison else []
        texts = [*axes.texts, *legend_texts, *(text for axis in ticks for text in axis.findobj(Text))]
        for text in texts:
            assert text.get_size() == 8, text
            assert contrast(ground_of(text.get_color(), text.get_alpha())) >= 4.5, text
        if axes.axison:  # no spike is cut
            low, high = axes.get_ylim()
            assert all(low <= np.nanmin(line.get_ydata()) <= np.nanmax(line.get_ydata()) <= high for line in axes.lines)
        lines = [line for line in axes.lines if not line.get_label().startswith(guides)]
        assert lines or axes.collections or axes is several[1]
        for line in lines:
            assert contrast(ground_of(line.get_color(), line.get_alpha())) >= 3, line
            assert line.get_linewidth() >= 0.4


@pytest.mark.parametrize("height", [1.8, 2.4, 4.0])
def test_panels_have_letters_of_one_height_beside_their_legends(height, two):
    panels = plot.new_axes(columns=2, panels=3, height=height)
    for axes, draw_one in zip(panels, (plot.path, plot.polhode, plot.momenta), strict=True):
        draw_one(two, axes)
    panels[0].figure.canvas.draw()
    legend_boxes = [legend.get_window_extent() for axes in panels for legend in axes.findobj(Legend)]
    letters = [next(t for t in axes.texts if t.get_text() == name) for axes, name in zip(panels, "abc", strict=True)]
    boxes = [letter.get_window_extent() for letter in letters]
    assert [box.y0 for box in boxes] == pytest.approx([boxes[0].y0] * 3, abs=0.1)
    for box in boxes:
        assert all(panels[0].figure.bbox.contains(*corner) for corner in (box.p0, box.p1))
        assert not any(box.overlaps(other) for other in legend_boxes)
    assert [axes.texts[:] for axes in plot.new_axes(panels=2, letters=False)] == [[], []]
    assert not plot.new_axes()[0].texts


def test_colours_are_those_of_the_pages(runs, two):
    ink = colours()
    assert [line.get_color() for line in plot.momenta(runs[0]).lines] == [ink["d1"], ink["d2"], ink["d3"]]
    assert path_of(plot.path(runs[0]))[0].get_color() == ink["d3"]
    assert path_of(plot.path(runs[0], director=1))[0].get_color() == ink["d1"]
    assert [line.get_color() for line in plot.twist_angle(two["standard"], swing=True).lines[:3]] == [
        ink["twist"],
        ink["d1"],
        ink["d3"],
    ]
    assert plot.reaction_moment(runs[0]).lines[0].get_color() == ink["frame"]


def test_a_run_has_one_colour_in_all_figures_of_one_component(two):
    """By its place alone; a component has its own, as d3 is navy and the twist purple, where there is one run."""
    figures = [plot.twist_angle(two), plot.energy(two), plot.orthonormality(two), plot.polhode(two)]
    figures += [plot.path(two, director=director) for director in (1, 2, 3)]
    with plot.style():
        looks = cycle()
    for label, look in zip(two, looks, strict=False):
        for axes in figures:
            (line,) = [line for line in axes.lines if line.get_label().split(", ")[-1] == label]
            assert line.get_color() == look["color"], (axes.get_ylabel(), label)
        for axes in figures:
            handles = [line for legend in axes.findobj(Legend) for line in legend.get_lines()]
            assert look["color"] in [line.get_color() for line in handles]


def test_the_energy_of_a_hanging_top_is_not_its_round_off():
    """A top that hangs at rest keeps V = -m g l and K = 0; one that nearly does exchanges energy, from V < 0."""
    top = nt.heavy_top([2, 2, 1], mass=1.5, centre_of_mass=(0, 0, 0.6))
    low, high = plot.energy(
        nt.simulate(top, t_end=2, step=0.1, rotation=Rotation.from_rotvec([np.pi, 0, 0]))
    ).get_ylim()
    assert high - low > 8
    almost = nt.simulate(top, t_end=2, step=0.1, rotation=Rotation.from_rotvec([np.pi - 0.1, 0, 0]))
    V = -1.5 * 9.81 * 0.6 * np.cos(0.1)
    names = ["$K$", f"$V$ + {-V:.4g} J", f"$K+V$ + {-V:.4g} J"]
    assert [line.get_label() for line in plot.energy(almost).lines] == names


def test_the_energy_of_a_fast_top_shows_the_exchange():
    """K is 18 J and changes by 0.03 J, as V does: curves of the changes fill the axes; the legend has the values."""
    top = nt.heavy_top([0.0127, 0.0127, 0.0025], mass=0.5, centre_of_mass=(0, 0, 0.15))
    lean = Rotation.from_euler("x", 20, degrees=True)
    run = nt.simulate(top, t_end=1, step=0.005, rotation=lean, material_angular_velocity=(0, 0, 120))
    axes = plot.energy(run)
    V = 0.5 * 9.81 * 0.15 * np.cos(np.radians(20))
    names = ["$K$ − 18 J", f"$V$ − {V:.4g} J", f"$K+V$ − {18 + V:.4g} J"]
    assert [line.get_label() for line in axes.lines] == names == legends(axes)[0]
    K, potential, total = (line.get_ydata() for line in axes.lines)
    assert abs(K - (run.kinetic_energy.values - 18)).max() < 1e-12
    assert total == pytest.approx(0, abs=1e-12)
    low, high = axes.get_ylim()
    assert min(np.ptp(K), np.ptp(potential)) > 0.4 * (high - low)
    assert axes.get_ylabel() == "change of energy (J)"
    several = plot.energy({"a": run, "b": run})
    assert [line.get_label() for line in several.lines[:3]] == ["Δ($K$), a", "Δ($V$), a", "Δ($K+V$), a"]
    slow = nt.simulate(top, t_end=1, step=0.005, rotation=lean)
    assert plot.energy(slow).get_ylabel() == "energy (J)"
    assert plot.energy({"fast": run, "slow": slow}).get_ylabel() == "change of energy (J)"


def test_names_of_axes_are_clear_of_paths_and_of_the_legend():
    """Of paths in all directions; and where an axis points at the legend."""
    rng = np.random.default_rng(3)
    for k in range(14):
        how = {"rotation": Rotation.random(random_state=rng), "material_angular_velocity": 2 * rng.normal(size=3)}
        run = nt.simulate(nt.standard([2, 4, 5]), t_end=3, **how)
        with apart():
            figures = [plot.path(run, **({"elevation": 57, "azimuth": 0} if k == 0 else {})), plot.polhode(run)]
        for axes in figures:
            axes.figure.canvas.draw()
            path = [line for line in axes.lines if "path" in line.get_label() or "polhode" in line.get_label()]
            points = axes.transData.transform(xy(*path[:2])) * 72 / axes.figure.dpi
            for text in filter(Text.get_text, axes.texts):
                box = text.get_window_extent()
                middle = (box.p0 + box.p1) / 2 * 72 / axes.figure.dpi
                assert np.hypot(*(points - middle).T).min() > 3.5  # points; letters are 8 high
                assert box.y0 > axes.get_legend().get_window_extent().y1
                assert axes.figure.bbox.contains(*box.p0)
                assert axes.figure.bbox.contains(*box.p1)


def test_a_tube_closes_and_has_its_radius():
    """A torus, seen from above: between two circles; every edge of a face belongs to two faces."""
    t = 2 * np.pi * np.arange(200) / 200
    circle = 3 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    for turns in (0, 3):
        (faces,) = plot.tube(circle, radius=0.5, turns=turns, **ABOVE).collections
        corners = np.array([path.vertices[:4] for path in faces.get_paths()])
        distance = np.linalg.norm(corners, axis=2)
        assert (distance.min(), distance.max()) == pytest.approx((2.5, 3.5), abs=0.02)
        edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 4).round(6) + 0.0
        ways = [tuple(sorted([tuple(e[:2]), tuple(e[2:])])) for e in edges]
        assert min(Counter(ways).values()) >= 2
    (faces,) = plot.ribbon(circle, [(0, 0, 2)] * 200, width=0.4, elevation=0, azimuth=0).collections
    assert np.ptp([path.vertices[:, 1] for path in faces.get_paths()]) == pytest.approx(0.4)
    with pytest.raises(ValueError, match="radius must be positive, got -1 in the unit of the points"):
        plot.tube(circle, radius=-1)
    with pytest.raises(ValueError, match=r"^a curve of size 6e.200 cannot be drawn; choose another unit of length$"):
        plot.ribbon(1e200 * circle, [(0, 0, 2)] * 200)


def test_files_have_a_journals_size_and_embedded_fonts(runs, tmp_path):
    drawn = plot.momenta(runs[0])
    for name in ("a.pdf", "a.png", "a.svg"):
        plot.save(drawn, tmp_path / name)
    layout, placed = drawn.figure.get_layout_engine(), type(drawn.figure.get_layout_engine()).execute
    with patch.object(type(layout), "execute", autospec=True, side_effect=placed) as laid_out:
        plot.save(drawn, tmp_path / "b.pdf", tmp_path / "b.png", tmp_path / "b.svg")
    assert laid_out.call_count == 2  # for the ticks, and then for their labels; not again for each file
    assert drawn.figure.get_layout_engine() is layout
    assert matplotlib.image.imread(tmp_path / "a.png").shape[1] == 3.5 * 300
    pdf = (tmp_path / "a.pdf").read_bytes()
    assert b"/Type3" not in pdf
    assert b"/Type42" in pdf or b"/CIDFontType2" in pdf
    assert b"/CreationDate" not in pdf
    assert b"<dc:date>" not in (tmp_path / "a.svg").read_bytes()
    assert [axes.figure.get_figwidth() for axes in plot.new_axes(columns=2, panels=2)] == pytest.approx([7.2, 7.2])
    with pytest.raises(ValueError, match="columns must be 1"):
        plot.new_axes(columns=3)


# Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291-1298, severity 1, on linear RGB
BLINDNESS = {
    "none": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def cielab(linear):
    """L*, a*, b* of linear sRGB, white D65."""
    xyz = linear @ np.transpose([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    f = xyz / [0.9505, 1, 1.089]
    f = np.where(f > 0.008856, np.cbrt(f), 7.787 * f + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def test_pyplot_shows_and_saves_the_figure_where_it_has_been_imported(runs, tmp_path):
    plt = pytest.importorskip("matplotlib.pyplot")
    with plot.style("springer"):
        ax = plot.momenta(runs[0])
    assert plt.gcf() is ax.figure
    assert ax.figure.journal == "springer"
    plt.savefig(tmp_path / "momenta.pdf")
    assert (tmp_path / "momenta.pdf").stat().st_size > 5000  # an empty one has 900 bytes
    with apart():
        plot.momenta(runs[0])
    assert plt.get_fignums() == [ax.figure.number]


def test_a_notebook_shows_the_figure_that_a_cell_ends_in(runs, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    axes = plot.momenta(runs[0], plot.new_axes(columns=2)[0])
    for shown in (axes, axes.figure):
        picture, size = shown._repr_png_()
        assert picture.startswith(b"\x89PNG")
        assert int.from_bytes(picture[16:20]) == 1440  # 7.2 in, twice as fine as it is shown
        assert size == {"width": 720}


def test_colours_are_told_apart_in_grey_and_with_any_colour_vision():
    with plot.style():
        shown = list(dict.fromkeys(look["color"] for look in cycle()))
    rgb = np.array([matplotlib.colors.to_rgb(colour) for colour in shown])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    grey = cielab(linear)[:, 0]
    assert len(grey) == 4
    assert np.diff(np.sort(grey[:3])).min() > 20
    assert np.diff(np.sort(grey)).min() > 8
    for name, matrix in BLINDNESS.items():
        seen = cielab(np.clip(linear @ np.transpose(matrix), 0, 1))
        gaps = [np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)]
        assert min(gaps) > 30, name
