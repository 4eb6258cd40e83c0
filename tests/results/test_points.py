"""Positions and velocities of material points: against SciPy, against finite differences, and as the mass of a body."""

import numpy as np
import pytest
import xarray

import nontwist as nt
from conftest import BODIES, PAPER_J
from refusals import says

RNG = np.random.default_rng(3)
X = RNG.normal(size=(5, 3))
EM = {"integrator": "energy-momentum", "order": 2}
PUSHED = {
    "t_end": 1,
    "step": 0.05,
    "load": nt.pulse((-61.8125, -26.875, 0)),
    "material_angular_velocity": (1.5, 4.5, 0),
}


@pytest.mark.parametrize("name", ["heavy_top", "suslov"])
def test_positions_by_scipy(name):
    """x = Λ X; x' by a central difference of order 4 of neighbouring states, which are closer than the steps."""
    t, e = 0.6, 1e-3
    times = [0.0, *(t + e * np.array([-2, -1, 0, 1, 2]))]
    start = {"angular_velocity": (1, -2, 0.5), "project": True}
    run = nt.simulate(BODIES[name](), times=times, step=times[-1] / 600, integrator="gauss", **start)
    x, v = nt.point_position(run, X), nt.point_velocity(run, X)
    turned = np.stack([nt.rotation(run).apply(one) for one in X], axis=1)
    np.testing.assert_allclose(x, turned, rtol=0, atol=1e-14)
    slope = np.einsum("k,kpx->px", [1, -8, 0, 8, -1], x.values[1:]) / (12 * e)
    np.testing.assert_allclose(v[3], slope, rtol=0, atol=1e-9)
    np.testing.assert_allclose(v, np.cross(run.angular_velocity.values[:, None], x), rtol=0, atol=1e-13)


def test_energy_and_momentum():
    """K = Σ ½ m |x'|² and π = Σ m x × x' at every node, where the velocities are not tangent too (eq-director-K)."""
    masses, points = RNG.uniform(0.5, 2, 6), RNG.normal(size=(3, 3))
    points = np.concatenate([points, points * [-1, -1, 1]])  # E3 is principal
    masses[3:] = masses[:3]
    run = nt.simulate(nt.nontwisting(nt.inertia.of_points(masses, points)), **PUSHED, **EM)
    x, v = nt.point_position(run, points).values, nt.point_velocity(run, points).values
    np.testing.assert_allclose(np.einsum("p,kpx,kpx->k", masses, v, v) / 2, run.kinetic_energy, rtol=1e-13)
    momentum = np.einsum("p,kpx->kx", masses, np.cross(x, v))
    np.testing.assert_allclose(momentum, run.spatial_momentum, rtol=0, atol=1e-12 * abs(momentum).max())
    assert abs(v - np.cross(run.angular_velocity.values[:, None], x)).max() > 1e-3  # erratum 7, and no round-off


def test_layout():
    how = PUSHED | {"integrator": "lie-midpoint"}
    run, plain = nt.simulate(nt.standard(PAPER_J), **how), nt.integrate(nt.standard(PAPER_J), **how)
    many = nt.simulate_ensemble(
        nt.standard(PAPER_J), **how | {"material_angular_velocity": np.eye(3), "variables": "all"}
    )
    for function, name, units in ((nt.point_position, "position", "m"), (nt.point_velocity, "velocity", "m s-1")):
        one, all_of_them = function(run, X[0]), function(run, X)
        assert one.dims == ("time", "axis")
        assert all_of_them.dims == ("time", "point", "axis")
        assert (one.name, one.attrs["units"]) == (name, units)
        assert set(one.coords) == {"time", "axis"}
        size = np.abs(all_of_them).max()  # sums of three products, in one order or another
        np.testing.assert_allclose(one, all_of_them.isel(point=0), rtol=0, atol=3 * np.finfo(float).eps * size)
        assert isinstance(function(plain, X), np.ndarray)
        np.testing.assert_allclose(function(plain, X), all_of_them, rtol=0, atol=1e-14)
        assert function(plain, X[0]).shape == (21, 3)
        assert function(many, X).dims == ("member", "time", "point", "axis")
        assert function(run.isel(time=-1), X[0]).dims == ("axis",)
        swapped = run.transpose(..., "axis", "director", "time")
        np.testing.assert_allclose(function(swapped, X).transpose(*all_of_them.dims), all_of_them, rtol=0, atol=1e-14)


@pytest.mark.parametrize("function", [nt.point_position, nt.point_velocity])
def test_what_is_refused(function):
    run = nt.simulate(nt.standard(PAPER_J), **PUSHED)
    name = {nt.point_position: "directors", nt.point_velocity: "director_velocities"}[function]
    for wrong, points in (
        (3, X),
        (run.drop_vars(name)[["quaternion", "moment"]], X),
        (run.isel(director=[0, 1]), X),
        (run.isel(director=0), X),
        (run, np.zeros((2, 2))),
        (run, np.zeros((2, 2, 3))),
        (run, 1.0),
        (run, (0, np.nan, 0)),
    ):
        with says():
            function(wrong, points)
    assert isinstance(function(run, np.empty((0, 3))), xarray.DataArray)
