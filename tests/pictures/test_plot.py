"""Artists and data, not pixels."""

import itertools
import sys
import threading
from collections import Counter
from functools import partial
from pathlib import Path
from unittest.mock import patch

import matplotlib
import matplotlib.style
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.legend import Legend
from matplotlib.text import Text
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import PAPER_J, shoelace
from nontwist import plot
from nontwist.comparison import observed_order, second_quotient
from nontwist.plot.journals import apart
from nontwist.plot.looks import LEAST, contrast, cycle
from nontwist.plot.timelines import MOST
from nontwist.viewer.content import content
from nontwist.viewer.drawing import Camera, _unpacked, colours
from refusals import says

ABOVE = {"elevation": 90, "azimuth": -90}  # x to the right, y up, z towards the viewer
FREE = {"material_angular_velocity": [6, -18, 0]}
SUSLOV = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]


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


def boxes(artists):
    """Where artists stand, when their figure is laid out."""
    artists[0].figure.draw_without_rendering()
    return [artist.get_window_extent() for artist in artists]


def named(axes, *names):
    """The lines with these labels."""
    return [next(line for line in axes.lines if line.get_label() == name) for name in names]


def path_of(axes, name="path"):
    """Near side and far side, start and end."""
    return named(axes, name, f"_{name}, far side", f"_start of {name}", f"_end of {name}")


def xy(*lines):
    points = np.concatenate([np.stack([line.get_xdata(), line.get_ydata()], axis=1) for line in lines])
    return points[np.isfinite(points).all(axis=1)]


def gap(points, *lines):
    """How far the farthest of the points, seen from above, is from what lines show."""
    return np.linalg.norm(points[:, None, :2] - xy(*lines)[None], axis=2).min(axis=1).max()


def ys(axes):
    return [line.get_ydata() for line in axes.lines]


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


def dashes(axes):
    return [str(line._dash_pattern) for line in axes.lines]


def inks(lines):
    return [line.get_color() for line in lines]


def test_component_labels(runs):
    run = runs[0].copy()
    space, body, d2 = plot.momenta(run), plot.momenta(run, frame="body"), plot.directors(run, director=2)
    expected = run.spatial_momentum, run.material_momentum, run.directors[:, 1]
    for axes, values in zip((space, body, d2), expected, strict=True):
        assert np.array_equal(np.transpose(ys(axes)), values)
        assert len(set(inks(axes.lines))) == len(set(dashes(axes))) == 3
    assert space.get_ylabel() == "spatial momentum $π$ (kg m$^{2}$ s$^{-1}$)"
    assert space.get_xlabel() == "time $t$ (s)"
    assert legends(body) == [["$Π_{1}$", "$Π_{2}$", "$Π_{3}$"]]
    run["kinetic_energy"].attrs = {"units": "eV", "symbol": "T_kin"}
    for first, limits in ((0.02, (0, 0.5)), (0.1, (0.1, 0.5))):  # 0 is shown where it is near
        axes = plot.energy(run.sel(time=slice(first, None)))
        assert axes.get_xlim() == limits
    assert (axes.get_ylabel(), len(axes.lines)) == (r"kinetic energy $T_{\mathrm{kin}}$ (eV)", 1)


def test_labels_that_were_dropped(two):
    run = two["non-twisting"]
    bare = run.drop_vars(["director", "axis", "quat", "constraint"])
    for draw in (
        plot.momenta,
        partial(plot.momenta, frame="body"),
        plot.multipliers,
        partial(plot.directors, director=1),
    ):
        axes, same = draw(bare), draw(run)
        assert legends(axes) == legends(same)
        assert np.array_equal(ys(axes), ys(same))
    assert np.array_equal(np.transpose(ys(axes)), run.directors.values[:, 0])


def test_runs_differ_by_line_style(two):
    axes = plot.momenta(two)
    colours, styles = inks(axes.lines), dashes(axes)
    assert colours[:3] == colours[3:]
    assert len(set(colours)) == 3
    assert styles == [styles[0]] * 3 + [styles[3]] * 3
    assert len(set(styles)) == 2
    assert np.array_equal(ys(axes)[4], two["standard"].spatial_momentum.sel(axis="y"))
    assert sorted(map(len, legends(axes))) == [2, 3]


def test_legends_inside_the_figure(two):
    several = {f"{name} body, {k}": two["non-twisting"] for name in ("one", "another") for k in "ab"}
    for draw in (plot.multipliers, plot.path, plot.polhode):
        axes = draw(several)
        found = boxes(axes.findobj(Legend))
        inside = axes.figure.bbox.padded(1)
        assert len(found) > 1
        assert all(inside.contains(*box.p0) and inside.contains(*box.p1) for box in found)
        assert not any(a.overlaps(b) for a, b in itertools.combinations([axes.bbox.padded(-2), *found], 2))
    small = nt.with_gravity(nt.standard([1e-8, 2e-8, 2.5e-8]), 1e-6, (0, 0, 0.01))
    axes = plot.energy(nt.simulate(small, t_end=5, angular_velocity=(1, 2, 0)))
    legend, exponent = boxes([*axes.findobj(Legend), axes.yaxis.get_offset_text()])
    assert axes.yaxis.get_offset_text().get_text()
    assert not legend.overlaps(exponent)
    assert legend.y1 <= axes.figure.bbox.y1 + 1


@pytest.mark.usefixtures("here")
def test_user_settings_win(two):
    """Letters of 16 pt, and rows of the legend that do not overlap."""
    page = (Path(__file__).parents[2] / "docs" / "gallery.md").read_text(encoding="utf-8")
    code = page.partition("## Figures for slides")[2].partition("```python\n")[2].partition("```")[0]
    exec(code, names := {"plot": plot, "runs": two})
    axes = names["ax"]
    assert {text.get_fontsize() for text in axes.findobj(Text) if text.get_text()} == {16.0}
    assert {line.get_linewidth() for line in axes.lines} == {2.5}
    first, second = (legend.get_window_extent() for legend in axes.findobj(Legend))
    assert not first.overlaps(second)
    with matplotlib.rc_context({"axes.prop_cycle": matplotlib.cycler(color=["#111111", "#222222"])}):
        axes = plot.momenta(two["standard"])
        assert inks(axes.lines) == ["#111111", "#222222", "#111111"]
        assert len(set(dashes(axes))) == 3
    with plot.style(), matplotlib.rc_context({"lines.linewidth": 2}):
        assert {line.get_linewidth() for line in plot.momenta(two["standard"]).lines} == {2}


STILL = {"t_end": 0.1, "step": 0.01}


def test_refusals(runs, two):
    run, trajectory = runs[0], nt.integrate(nt.nontwisting(PAPER_J), **STILL)
    many, later = run.expand_dims(member=2), nt.resample(two["standard"], two["standard"].time)
    rest, other = nt.simulate(nt.standard(PAPER_J), **STILL), nt.simulate(nt.standard([3, 4, 5]), **STILL, **FREE)
    for wrong in ([run], {}, {"a": run, "b": 1}, trajectory, {"many": many}, run[["quaternion"]]):
        with says():
            plot.momenta(wrong)
    for function, *given, options in (
        (plot.momenta, {str(k): run for k in range(9)}, {}),
        (plot.momenta, run, {"frame": 0}),
        (plot.directors, run, {"director": 0}),
        (plot.energy_drift, later, {}),
        (plot.second_quotient, run, {}),
        (plot.reaction_moment, two, {}),
        (plot.multipliers, other, {}),
        (plot.polhode, rest, {}),
        (plot.polhode, {"a": run, "b": other}, {}),
        (plot.tube, SQUARE, {"radius": -1}),
        (plot.ribbon, 6e199 * np.array(SQUARE), [(0, 0, 2)] * 4, {}),
        (plot.new_axes, {"columns": 3}),
        (lambda: plot.style("nature").__enter__(), {}),
    ):
        with says():
            function(*given, **options)


def test_energy_drift_counts_work(two):
    run = two["standard"]
    assert np.ptp(run.kinetic_energy.values) > 10
    first, second, round_off = ys(plot.energy_drift(two))
    assert max(first.max(), second.max()) < 1e-14
    assert first.min() == round_off[0] == np.finfo(float).eps
    spoilt = run.assign(kinetic_energy=run.kinetic_energy.copy())
    spoilt["kinetic_energy"][50:] += 1e-6 * float(run.kinetic_energy.max())
    drift = ys(plot.energy_drift(spoilt))[0]
    assert drift[50:] == pytest.approx(1e-6, rel=1e-5)
    assert drift[:50].max() < 1e-14


def test_long_curves_keep_their_extremes(runs):
    """Of a rotation, and of defects, of which the largest are kept."""
    t = np.linspace(0, 1, 100_000)
    run = runs[0][["directors", "orthonormality_defect"]].isel(time=np.zeros(t.size, int)).assign_coords(time=t)
    run["directors"][:, 2, 0] = np.sin(2000 * t)
    x, y = plot.directors(run).lines[0].get_data()
    assert (x[0], x[-1], x.size <= MOST + 2, np.ptp(y)) == (0, 1, True, pytest.approx(2, abs=1e-3))
    run["orthonormality_defect"][:] = np.arange(t.size) % 1000 * 1e-9
    axes = plot.orthonormality(run)
    assert (ys(axes)[0].size, ys(axes)[0].max(), axes.get_yscale()) == (200, 999e-9, "log")


def test_second_quotient_with_its_limit(runs):
    quotient = second_quotient(*runs)
    spike = quotient.copy()
    spike[7] = 5.5
    for each, order in ((quotient, {}), (spike, {}), ({"a": quotient, "b": quotient}, {"order": 1})):
        axes = plot.second_quotient(each, **order)
        *curves, limit = ys(axes)
        assert limit[0] == 2 ** order.get("order", 2)
        assert axes.get_ylim()[0] < np.min(curves) < np.max(curves) < axes.get_ylim()[1]
    assert legends(axes) == [["a", "b"]]
    with says():  # whose limit is another
        plot.second_quotient(observed_order(*runs))


def test_path_hides_what_lies_behind(runs):
    near, far, start, end = path_of(plot.path(runs[0], elevation=25, azimuth=35))
    seen, hidden = (np.isfinite(line.get_xdata()) for line in (near, far))
    assert LEAST <= contrast(far.get_color()) < 1.1 * LEAST < contrast(near.get_color())  # as pale as may be
    assert far.get_linewidth() < near.get_linewidth()
    assert (seen | hidden).all()
    assert (seen & hidden).sum() < 0.1 * seen.size
    assert 0.3 < hidden.mean() < 0.7
    assert np.linalg.norm(xy(near), axis=1).max() <= 1 + 1e-12
    assert start.get_marker() != end.get_marker()


def test_view_of_a_path():
    """Circles about a direction, of which small ones are seen from its side, and large ones where they are wide."""
    for azimuth, elevation, radius, expected in (
        (100, 0, 20, (120, 20)),
        (100, 70, 20, (120, 50)),
        (-60, 0, 50, (-40, 25)),
        (130, 0, 90, (80, 25)),
        (140, 0, 90, (5, 25)),
    ):
        around = np.column_stack([np.linspace(0, 360, 99), np.full(99, radius)])
        centre = Rotation.from_euler("ZY", [azimuth, 90 - elevation], degrees=True)
        axes = plot.path(nt.twist(centre * Rotation.from_euler("ZY", around, degrees=True), np.arange(99.0)))
        x, y, z = (next(text.xy for text in axes.texts if text.get_text() == f"${name}$") for name in "xyz")
        a = np.arctan2(-x[0], y[0])  # from what the arrows show of right and up
        e = np.arctan2(-x[1] * np.cos(a) - y[1] * np.sin(a), z[1])
        assert np.degrees([a, e]) == pytest.approx(expected, abs=0.3)


def test_path_of_failed_members(two):
    """What a run has not reached is NaN: the path ends before it."""
    run = two["standard"]
    whole, part = plot.path(run.isel(time=slice(50))), plot.path(run.where(run.time < run.time[50]))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(ys(whole), ys(part), strict=True))
    with pytest.raises(ValueError, match="no attitude of the run is finite"):
        plot.path(run.where(run.time < 0))


def test_path_from_above(two):
    """And of the grid of the globe, parallels are circles of the radius cos φ, and meridians are straight."""
    axes = plot.path(two["standard"], **ABOVE)
    near, far, start, end = path_of(axes)
    d = two["standard"].directors.sel(director=3).values
    assert xy(start, end) == pytest.approx(d[[0, -1], :2], abs=1e-12)
    height = (d[1:] + d[:-1])[:, 2]
    assert gap(d[1:][height > 0.1], near) < np.radians(1)
    assert gap(d[1:][height < -0.1], far) < np.radians(1)
    parallels, meridians = (
        xy(*(line for line in axes.lines if line.get_label().startswith(name))) for name in ("_parallel", "_meridian")
    )
    assert set(np.hypot(*parallels.T).round(9)) == set(np.cos(np.radians([0, 30, 60])).round(9))
    x, y = meridians[np.hypot(*meridians.T) > 0.1].T
    assert np.hypot(x, y).max() == pytest.approx(1, abs=1e-9)
    assert set(np.degrees(np.arctan2(y, x)).round(6) % 180) == {0, 30, 60, 90, 120, 150}


def test_great_circle_of_free_body(runs, two):
    """After the load of case 3 ends at 0.5 s the non-twisting body stays on it, the standard body leaves it."""

    def leaves(run, times):
        circle = named(plot.path(run, great_circle=True, **ABOVE), "great circle", "_great circle, far side")
        return gap(run.directors.sel(director=3, time=times).values, *circle)

    assert leaves(runs[0], slice(None)) < np.radians(1)
    sparse = path_of(plot.path(runs[0].isel(time=slice(None, None, 5)), **ABOVE))[:2]  # drawn between states as well
    assert gap(runs[0].directors.sel(director=3).values, *sparse) < np.radians(2)
    assert leaves(two["non-twisting"], slice(0.5, None)) < np.radians(1)
    assert leaves(two["non-twisting"], slice(0, 0.3)) > 0.1
    assert leaves(two["standard"], slice(0.5, None)) > np.radians(4)
    late = {"t_end": 1, "step": 0.01, "material_angular_velocity": [1.5, 4.5, 0], "load": nt.pulse((9, 9, 0), 0.5, 1)}
    assert leaves(nt.simulate(nt.nontwisting(PAPER_J), **late), slice(0, 0.5)) < np.radians(1)


def test_triads_are_the_other_directors(runs):
    axes = plot.path(runs[0], triads=9, **ABOVE)
    q = runs[0].directors.values
    for k in (0, 1):
        near, far = named(axes, f"$d_{k + 1}$", f"_$d_{k + 1}$, far side")
        foot, tip = xy(near, far).reshape(9, 2, 2).transpose(1, 0, 2)
        which = np.linalg.norm(q[:, None, 2, :2] - foot, axis=2).argmin(0)
        assert np.median(np.linalg.norm(tip - foot - 0.2 * q[which, k, :2], axis=1)) < 1e-12
        assert min(len(xy(line)) for line in (near, far)) > 0
    assert legends(axes) == [["start", "end", "$d_1$", "$d_2$"]]
    shown = plot.path({"a": runs[0], "b": runs[0]}, triads=2, **ABOVE).get_legend().get_lines()
    assert len({line.get_color() for line in shown if line.get_linestyle() != "None"}) == 4  # two runs, two directors


GUIDES = ("_meridian", "_parallel", "_level", "_child")  # what only helps the eye


@pytest.mark.parametrize("draw_one", [plot.path, plot.polhode])
def test_sphere_colours(draw_one, runs):
    with matplotlib.style.context("dark_background"):
        axes = draw_one(runs[0])
        assert max(to_rgb(axes.patches[0].get_facecolor())) < 0.05
        for line in [*axes.lines, axes.get_legend().get_lines()[1]]:
            assert line.get_label().startswith(GUIDES) or contrast(line.get_color(), "black") >= 2.9
        assert min(contrast(text.get_color(), "black") for text in axes.texts) > 4.5


def test_twist_angle_of_long_steps():
    """Of states half a radian apart a frame would be transported 0.14 rad wrong."""
    free, start = nt.standard([3, 4, 5]), {"tolerance": 1e-9, "t_end": 10, "material_angular_velocity": (1, 2, 0.5)}
    few, many = nt.simulate(free, **start), nt.simulate(free, times=np.linspace(0, 10, 999), **start)
    assert few.sizes["time"] < 40
    bare = nt.twist(few.drop_vars("mean_twist_rate"))
    assert abs(bare.twist_angle[-1] - nt.twist(many).twist_angle[-1]) > 0.1
    with says(UserWarning):
        drawn = [[y[-1] for y in ys(plot.twist_angle(run, swing=True))[:3]] for run in (few, many)]
    plot.twist_angle(nt.resample(few, np.linspace(0, 10, 200)))  # without a warning
    assert drawn[0] == pytest.approx(drawn[1], abs=1e-7)
    shown = [[_unpacked(content(run)[key])[-1] for key in ("twist", "swing", "area")] for run in (few, many)]
    assert shown[0] == pytest.approx(shown[1], abs=1e-6)
    held = nt.simulate(nt.suslov(SUSLOV, (0, 0, 1)), project=True, **start)
    part = held.sel(time=slice(1, 9))  # whose intervals are those of the whole run
    with says(UserWarning):
        of_held, of_part = (ys(plot.twist_angle(run))[0] for run in (held, part))
    assert abs(of_held).max() < 1e-14
    assert len(of_part) == part.sizes["time"]


def test_twist_angle_of_bodies():
    spin = nt.simulate(nt.standard([2, 2, 1]), t_end=4, step=0.02, material_angular_velocity=[0, 0, 3], order=8)
    degrees, axes = plot.twist_angle(spin, degrees=True), plot.twist_angle(spin, swing=True)
    assert ys(degrees)[0] == pytest.approx(np.degrees(3 * spin.time.values), abs=1e-8)
    assert degrees.get_ylabel() != axes.get_ylabel() == "angle (rad)"
    psi, tau, of_area, _ = ys(axes)
    assert psi == pytest.approx(3 * spin.time.values, abs=1e-10)
    assert np.isnan(tau).sum() == 2  # the jumps of a wrapped angle that reaches 12
    assert abs(of_area).max() < 1e-10
    body = nt.suslov(SUSLOV, [1, 0, 0.2])
    axes = plot.twist_angle(nt.simulate(body, t_end=4, step=0.01, material_angular_velocity=[0.2, 3, -1]))
    assert abs(ys(axes)[0]).max() < 1e-5
    assert np.ptp(axes.get_ylim()) > 0.01


def test_curves_of_many_swings():
    """33 swings of 60°: ψ is a thin line on the wide one of τ, whose dashes would merge; two runs look likewise."""

    def recorded(periods):
        t = np.linspace(0, 9 * periods, round(200 * periods) + 1)
        turn, lean = np.sin(2 * np.pi * t / 9), 0.02 * np.sin(2 * np.pi * t / 9 + 1)
        swing = Rotation.from_euler("YX", np.stack([lean, 0.5 * turn], axis=1))
        return nt.twist(swing * Rotation.from_rotvec(np.outer(turn, [0, 0, 1])), t)

    long = recorded(33)
    for axes in (plot.twist_angle(long, swing=True), plot.twist_angle({"true": long, "markers": long})):
        thin, wide = axes.lines[:2]
        assert wide.get_linewidth() >= 2 * thin.get_linewidth()
        assert thin.get_zorder() > wide.get_zorder()
        assert {line.get_linestyle() for line in (thin, wide)} == {"-"}
        widths = [line.get_linewidth() for line in axes.findobj(Legend)[0].get_lines()]
        assert widths[:2] == [thin.get_linewidth(), wide.get_linewidth()]
    with plot.style():
        assert inks((thin, wide)) == [look["color"] for look in cycle()[:2]]
    assert {line.get_linewidth() for line in plot.twist_angle(long, swing=True, lw=0.9).lines[:3]} == {0.9}
    few, more = (plot.twist_angle(recorded(periods), swing=True).lines[:3] for periods in (10, 10.5))
    assert [lines[1].get_linestyle() for lines in (few, more)] == ["--", "-"]
    assert thin.get_zorder() == few[0].get_zorder()
    assert {line.get_linewidth() for line in few} == {1.1}


def test_multipliers_and_reaction_moment(runs, two):
    axes = plot.reaction_moment(nt.simulate(nt.nontwisting(PAPER_J), t_end=0.1, step=1e-3, order=8, **FREE))
    assert ys(axes)[0] == pytest.approx(-66.857142857, rel=1e-9)
    assert axes.get_ylabel() == "reaction moment $-μ$ (N m)"
    assert np.ptp(axes.get_ylim()) > 1  # a constant looks like one
    axes = plot.multipliers(two["non-twisting"])
    names = [name for row in legends(axes) for name in row]
    assert sorted(names) == sorted([f"$λ_{{{k}}}$" for k in ("11", "22", "33", "23", "13", "12")] + ["$μ$"])
    assert len({(line.get_color(), str(line._dash_pattern)) for line in axes.lines}) == 7
    assert np.array_equal(ys(axes)[-1], two["non-twisting"].multipliers.sel(constraint="nh"))
    assert len(plot.multipliers(two).lines) == 7 + 6
    assert plot.multipliers(runs[0]).get_ylabel() == "multiplier $μ$ (N m)"


def test_polhode():
    """One of a symmetric top is a circle, without a separatrix."""
    J = np.array([[1.2, 0.1, 0], [0.1, 2, 0.2], [0, 0.2, 3]])
    how = {"t_end": 4, "step": 0.02, "material_angular_velocity": [0.5, 2, 1]}
    run = nt.simulate(nt.standard(J), **how)
    axes = plot.polhode(run, **ABOVE)
    near, far, start, end = path_of(axes, "polhode")
    W = run.material_angular_velocity.values
    x = W / np.sqrt(np.einsum("ki,ij,kj->k", W, J, W))[:, None] * np.sqrt(np.linalg.eigvalsh(J)[0])
    assert xy(start, end) == pytest.approx(x[[0, -1], :2], abs=1e-12)
    assert gap(x, near, far) < np.radians(1)
    reached = run.assign(material_angular_velocity=run.material_angular_velocity.where(run.time < 2.01))
    assert xy(*path_of(plot.polhode(reached, **ABOVE), "polhode")[2:]) == pytest.approx(x[[0, 100], :2], abs=1e-12)
    assert legends(axes) == [["start", "end", "separatrix"]]
    axes = plot.polhode(nt.simulate(nt.standard([2, 2, 1]), **how), **ABOVE)
    assert np.ptp(np.linalg.norm(xy(*named(axes, "polhode")), axis=1)) < 1e-3
    assert legends(axes) == [["start", "end"]]
    pushed = nt.simulate(nt.suslov(J, [0, 1, 1]), t_end=4, step=0.025, load=nt.pulse((-1, -2, 0), start=0, end=0.5))
    axes = plot.polhode(pushed, **ABOVE)  # from rest, and then on the circle W·n = 0
    circle = named(axes, r"$W\cdot n=0$", r"_$W\cdot n=0$, far side")
    assert gap(xy(*path_of(axes, "polhode")), *circle) < np.radians(1)
    axes = plot.polhode(nt.simulate(nt.standard([3, 4, 5]), **how), **ABOVE)
    levels = [xy(line).T for line in axes.lines if line.get_label().lstrip("_").startswith(("level", "separatrix"))]
    squares = ((9 * x**2 + 16 * y**2 + 5 * (3 - 3 * x**2 - 4 * y**2)) / 3 for x, y in levels)  # of |Π|² = 2K J
    thirds = [3 + 2 * np.sin(np.radians(angle)) ** 2 for angle in (15, 30, 60, 75)]
    assert np.unique(np.concatenate([*squares]).round(6)) == pytest.approx(sorted([*thirds, 4]), abs=1e-6)
    for moments in ([3, 4, 5], [1, 5, 5.5]):  # the ellipsoid fills its figure
        axes = plot.polhode(nt.simulate(nt.standard(moments), t_end=3, material_angular_velocity=(1.2, 2.5, 0.1)))
        outline, rows = boxes([axes.patches[0], axes.get_legend()])
        whole = axes.figure.bbox.width * (axes.figure.bbox.height - rows.height)
        assert outline.width * outline.height > 0.5 * whole


def test_threads_leave_settings():
    """One that begins while another draws would take the settings of figures for those of the user."""
    before, drawn = dict(matplotlib.rcParams), threading.Event()

    def other():
        with plot.style():
            drawn.set()
            first.join(1)

    def draw():
        with plot.style():
            second.start()
            drawn.wait(0.3)

    first, second = threading.Thread(target=draw), threading.Thread(target=other)
    first.start()
    first.join()
    second.join()
    assert dict(matplotlib.rcParams) == before


def test_callers_axes_and_properties(runs, two):
    before = dict(matplotlib.rcParams)
    for name in FUNCTIONS:
        axes = plot.new_axes(columns=2)[0]
        assert draw(name, runs, two, axes, alpha=0.4, lw=3) is axes
        drawn = axes.collections if name in ("tube", "ribbon") else axes.lines
        assert any((one.get_alpha(), np.max(one.get_linewidth())) == (0.4, 3) for one in drawn), name
        kind = "PolyCollection" if name in ("tube", "ribbon") else "Line2D"
        told = f"^plot.{name} accepts its own arguments and properties of matplotlib's {kind}; got glow: "
        with pytest.raises(ValueError, match=told):
            draw(name, runs, two, glow=1)
    assert dict(matplotlib.rcParams) == before
    axes = plot.momenta(two, color="red")
    for lines in (axes.lines, *(legend.get_lines() for legend in axes.findobj(Legend))):
        assert set(inks(lines)) == {"red"}


def test_journals(runs):
    for journal, one, two_wide in (("springer", 84, 174), ("elsevier", 90, 190)):
        with plot.style(journal):
            axes = plot.path(runs[0])
            panels = plot.new_axes(columns=2, panels=2)
        assert 25.4 * axes.figure.get_size_inches() == pytest.approx([one, one])
        assert [25.4 * each.figure.get_figwidth() for each in panels] == pytest.approx([two_wide] * 2)
        assert axes.get_legend().get_texts()[0].get_family() == ["sans-serif"]
    widths = [plot.new_axes(columns=k)[0].figure.get_figwidth() for k in (1, 2)]
    assert widths == pytest.approx([3.5, 7.2])


def contrast_of(artist):
    """With white, of its colour on white."""
    alpha = artist.get_alpha()
    return contrast(tuple(1 - (1 if alpha is None else alpha) * (1 - x) for x in to_rgb(artist.get_color())))


def test_print_size(runs, two):
    """Letters 8 pt high, 4.5 times as dark as the ground; lines that are data or explain it 3 times (WCAG)."""
    panel, _ = plot.new_axes(columns=2, panels=2)
    figures = [draw(name, runs, two) for name in FUNCTIONS] + [plot.momenta(two, panel)]
    for axes in [*figures, plot.path(two, triads=5, great_circle=True)]:
        texts = [*axes.texts, *(text for legend in axes.findobj(Legend) for text in legend.get_texts())]
        if axes.axison:
            low, high = axes.get_ylim()  # no spike is cut
            assert all(low <= np.nanmin(y) <= np.nanmax(y) <= high for y in ys(axes))
            for axis in (axes.xaxis, axes.yaxis):
                texts += [*axis.get_ticklabels(which="both"), axis.label, axis.get_offset_text()]
        for text in texts:
            assert text.get_size() == 8, text
            assert contrast_of(text) >= 4.5, text
        lines = [line for line in axes.lines if not line.get_label().startswith(GUIDES)]
        assert lines or axes.collections
        for line in lines:
            assert contrast_of(line) >= 3, line
            assert line.get_linewidth() >= 0.4


def test_panel_letters(two):
    panels = plot.new_axes(columns=2, panels=3, height=1.8)
    for axes, draw_one in zip(panels, (plot.path, plot.polhode, plot.momenta), strict=True):
        draw_one(two, axes)
    letters = [text for axes in panels for text in axes.texts if text.get_text() in ("a", "b", "c")]
    found = boxes(letters)
    assert [box.y0 for box in found] == pytest.approx([found[0].y0] * 3, abs=0.1)
    for box in found:
        assert all(panels[0].figure.bbox.contains(*corner) for corner in (box.p0, box.p1))
        assert not any(box.overlaps(x.get_window_extent()) for axes in panels for x in axes.findobj(Legend))
    assert [axes.texts[:] for axes in plot.new_axes(panels=2, letters=False) + plot.new_axes()] == [[], [], []]


def test_colours_of_the_pages(runs, two):
    """Of one run those of components; of several one for each, in all figures of one component, by its place alone."""
    ink = colours()
    for axes, names in (
        (plot.momenta(runs[0]), ("d1", "d2", "d3")),
        (plot.twist_angle(two["standard"], swing=True), ("twist", "d1", "d3")),
        (plot.reaction_moment(runs[0]), ("frame",)),
        *((plot.path(runs[0], director=k), [f"d{k}"]) for k in (1, 3)),
    ):
        own = [line for line in axes.lines if not line.get_label().startswith(GUIDES)]
        assert inks(own[: len(names)]) == [ink[name] for name in names]
    figures = [draw_one(two) for draw_one in (plot.twist_angle, plot.energy, plot.polhode)]
    with plot.style():
        looks = cycle()
    for axes in [*figures, *(plot.path(two, director=director) for director in (1, 2, 3))]:
        for label, look in zip(two, looks, strict=False):
            (line,) = [line for line in axes.lines if line.get_label().split(", ")[-1] == label]
            assert line.get_color() == look["color"], (axes.get_ylabel(), label)
            assert any(look["color"] in inks(legend.get_lines()) for legend in axes.findobj(Legend))


def test_energy_of_tops():
    """One that hangs at rest keeps K = 0 and V = -m g l; of a fast one K is 18 J and changes by 0.03 J, as V does."""
    top = nt.heavy_top([2, 2, 1], mass=1.5, centre_of_mass=(0, 0, 0.6))
    still, almost = (
        plot.energy(nt.simulate(top, t_end=2, step=0.1, rotation=Rotation.from_rotvec([np.pi - lean, 0, 0])))
        for lean in (0, 0.1)
    )
    assert np.ptp(still.get_ylim()) > 8
    V = -1.5 * 9.81 * 0.6 * np.cos(0.1)
    assert legends(almost) == [["$K$", f"$V$ + {-V:.4g} J", f"$K+V$ + {-V:.4g} J"]]
    top = nt.heavy_top([0.0127, 0.0127, 0.0025], mass=0.5, centre_of_mass=(0, 0, 0.15))
    how = {"t_end": 1, "step": 0.005, "rotation": Rotation.from_euler("x", 20, degrees=True)}
    slow, run = nt.simulate(top, **how), nt.simulate(top, material_angular_velocity=(0, 0, 120), **how)
    axes, several = plot.energy(run), plot.energy({"a": run, "b": run})
    V = 0.5 * 9.81 * 0.15 * np.cos(np.radians(20))
    names = ["$K$ − 18 J", f"$V$ − {V:.4g} J", f"$K+V$ − {18 + V:.4g} J"]
    assert [line.get_label() for line in axes.lines] == names == legends(axes)[0]
    K, potential, total = ys(axes)
    assert abs(K - (run.kinetic_energy.values - 18)).max() < 1e-12
    assert total == pytest.approx(0, abs=1e-12)
    assert min(np.ptp(K), np.ptp(potential)) > 0.4 * np.ptp(axes.get_ylim())  # curves fill the axes
    assert [line.get_label() for line in several.lines[:3]] == ["Δ($K$), a", "Δ($V$), a", "Δ($K+V$), a"]
    labels = [each.get_ylabel() for each in (axes, plot.energy(slow), plot.energy({"fast": run, "slow": slow}))]
    assert labels == ["change of energy (J)", "energy (J)", "change of energy (J)"]


def test_axis_names_are_clear():
    """Where an axis points at the legend; and where the path starts at the place that the name of x would have."""
    rng = np.random.default_rng(3)
    place = Camera(*np.radians([25, 25])).view().T @ (-0.55, -0.5, 0.669)
    starts = Rotation.random(random_state=rng), Rotation.align_vectors([place], [[0, 0, 1]])[0]
    for start, looks in zip(starts, ({"elevation": 57, "azimuth": 0}, {"elevation": 25, "azimuth": 25}), strict=True):
        how = {"rotation": start, "material_angular_velocity": 2 * rng.normal(size=3)}
        run = nt.simulate(nt.standard([2, 4, 5]), t_end=3, **how)
        with apart():
            figures = [plot.path(run, **looks), plot.polhode(run)]
        for axes in figures:
            texts = [text for text in axes.texts if text.get_text()]
            legend, *found = boxes([axes.get_legend(), *texts])
            path = [line for line in axes.lines if "path" in line.get_label() or "polhode" in line.get_label()]
            points = axes.transData.transform(xy(*path[:2]))
            for box in found:
                away = np.hypot(*(points - (box.p0 + box.p1) / 2).T).min()
                assert away * 72 / axes.figure.dpi > 3.5  # points; letters are 8 high
                assert box.y0 > legend.y1
                assert axes.figure.bbox.contains(*box.p0)
                assert axes.figure.bbox.contains(*box.p1)


def test_closed_tube():
    """A torus, seen from above: between two circles; every edge of a face belongs to two faces."""
    t = 2 * np.pi * np.arange(200) / 200
    circle = 3 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    for turns in (0, 3):
        (faces,) = plot.tube(circle, radius=0.5, turns=turns, **ABOVE).collections
        corners = np.array([path.vertices[:4] for path in faces.get_paths()])
        distance = np.linalg.norm(corners, axis=2)
        assert (distance.min(), distance.max()) == pytest.approx((2.5, 3.5), abs=1e-14)
        edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 4).round(6) + 0.0
        ways = [tuple(sorted([tuple(e[:2]), tuple(e[2:])])) for e in edges]
        assert min(Counter(ways).values()) >= 2
        far, near = np.split(shoelace(corners), 2)  # the near ones are drawn over the far ones, and seen from outside
        assert (-far.sum(), near.sum()) == pytest.approx([np.pi * (3.5**2 - 2.5**2)] * 2, rel=0.02)
    (faces,) = plot.ribbon(circle, circle, **ABOVE).collections  # of 12 % of the size, which is 6 √2
    area = shoelace(np.array([path.vertices[:4] for path in faces.get_paths()])).sum()
    assert abs(area) == pytest.approx(2 * np.pi * 3 * 0.12 * 6 * np.sqrt(2), rel=1e-3)
    (other,) = plot.ribbon(circle, -circle, **ABOVE).collections  # both sides are lit
    assert np.sum(other.get_facecolors()) == pytest.approx(np.sum(faces.get_facecolors()))
    (faces,) = plot.ribbon(circle, [(0, 0, 2)] * 200, width=0.4, elevation=0, azimuth=0).collections
    assert np.ptp([path.vertices[:, 1] for path in faces.get_paths()]) == pytest.approx(0.4)


def test_files_for_a_journal(tmp_path):
    """Of axes with ten ticks where there was room for five: labels are placed beside those that are drawn."""
    (ax,) = plot.new_axes(height=2.45)
    with plot.style():
        ax.plot([1e-3, 1], [9.422865739818295, -9.331086372293814])
        ax.set(xlabel="start.angular_velocity.body.2 (rad s$^{-1}$)", xscale="log")
        ax.set_ylabel("material angular velocity $W_{1}$ (rad s$^{-1}$)")
    layout = ax.figure.get_layout_engine()
    files = [tmp_path / f"a.{kind}" for kind in ("pdf", "png", "svg")]
    with patch.object(type(layout), "execute", autospec=True, side_effect=type(layout).execute) as laid_out:
        plot.save(ax, *files)
    assert laid_out.call_count == 2  # for the ticks, and then for their labels; not again for each file
    assert ax.figure.get_layout_engine() is layout
    assert ax.yaxis.label.get_window_extent().x0 >= 0
    pdf, svg = files[0].read_bytes(), files[2].read_bytes()
    assert matplotlib.image.imread(files[1]).shape[1] == 3.5 * 300
    assert b"/Type42" in pdf or b"/CIDFontType2" in pdf
    for word, text in ((b"/Type3", pdf), (b"/CreationDate", pdf), (b"<dc:date>", svg)):
        assert word not in text


def test_pyplot(runs, tmp_path):
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


def test_notebook(runs, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    axes = plot.momenta(runs[0], plot.new_axes(columns=2)[0])
    for shown in (axes, axes.figure):
        picture, size = shown._repr_png_()
        assert picture.startswith(b"\x89PNG")
        assert int.from_bytes(picture[16:20]) == 1440  # 7.2 in, twice as fine as it is shown
        assert size == {"width": 720}


# Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291-1298, severity 1, on linear RGB
BLINDNESS = {
    "grey": [[0.2126, 0.7152, 0.0722]] * 3,
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


def test_colours_in_grey():
    with plot.style():
        rgb = np.array([to_rgb(colour) for colour in dict.fromkeys(look["color"] for look in cycle())])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    assert len(linear) == 4
    for name, matrix in BLINDNESS.items():
        seen = cielab(np.clip(linear @ np.transpose(matrix), 0, 1))
        for count, least in ((3, 20), (4, 8)) if name == "grey" else ((4, 30),):
            assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen[:count], 2)) > least, name
