"""Artists and data, not pixels."""

import matplotlib
import numpy as np
import pytest

from conftest import PAPER_J
from nontwist import heavy_top, nontwisting, plot, second_quotient, simulate
from nontwist.plot.style import new_axes


@pytest.fixture(scope="module")
def runs():
    W = {"material_angular_velocity": [6, -18, 0]}
    return [simulate(nontwisting(PAPER_J), t_end=0.5, step=0.01 / k, **W) for k in (1, 2, 4)]


@pytest.mark.parametrize(("frame", "name"), [("space", "spatial_momentum"), ("body", "material_momentum")])
def test_momenta(runs, frame, name):
    lines = plot.momenta(runs[0], frame=frame)
    assert len(lines) == 3
    for k, line in enumerate(lines):
        assert np.array_equal(line.get_ydata(), runs[0][name][:, k])
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 3
    assert "kg m²/s" in lines[0].axes.get_ylabel()
    with pytest.raises(ValueError, match="frame must be 'space' or 'body', got 'lab'"):
        plot.momenta(runs[0], frame="lab")


def test_energy_shows_the_potential_where_there_is_one(runs):
    assert len(plot.energy(runs[0])) == 1
    top = simulate(heavy_top([2, 2, 1], 1, [0, 0, 0.5]), t_end=0.1, step=0.01, angular_velocity=[1, 0, 0])
    lines = plot.energy(top)
    assert len(lines) == 3
    assert np.ptp(lines[2].get_ydata()) < 1e-12


def test_second_quotient_with_its_limit(runs):
    curve, limit = plot.second_quotient(second_quotient(*runs))
    assert limit.get_ydata()[0] == 4
    low, high = curve.axes.get_ylim()
    assert low < curve.get_ydata().min() < curve.get_ydata().max() < high


def test_path_hides_what_lies_behind(runs):
    near, far, start, end = plot.path(runs[0], elevation=25, azimuth=35)
    seen = np.isfinite(near.get_xdata())
    hidden = np.isfinite(far.get_xdata())
    assert far.get_alpha() < near.get_alpha()
    assert (seen | hidden).all()
    assert (seen & hidden).sum() < 0.1 * seen.size
    assert 0.3 < hidden.mean() < 0.7
    xy = np.stack([near.get_xdata(), near.get_ydata()])[:, seen]
    assert np.linalg.norm(xy, axis=0).max() <= 1 + 1e-12
    assert start.get_marker() != end.get_marker()


def test_given_axes_are_used_and_nothing_global_changes(runs):
    before = dict(matplotlib.rcParams)
    axes = new_axes()[0]
    for draw in (plot.momenta, plot.energy, plot.path):
        assert all(artist.axes is axes for artist in draw(runs[0], axes))
    assert dict(matplotlib.rcParams) == before
