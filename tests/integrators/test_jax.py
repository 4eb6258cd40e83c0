"""Runs as functions of JAX have the values of `integrate`, and the derivatives of differences and of our own."""

import re
import sys

import numpy as np
import pytest

import nontwist as nt
from integrators.test_derivatives import DEAD, LOADED, NUMBERS, W0, J, loaded
from integrators.test_derivatives import R0 as TURN
from nontwist.inertia import euler_inertia
from nontwist.jax import function
from refusals import refused_as, says

jax = pytest.importorskip("jax")
jnp = jax.numpy
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_disable_most_optimizations", True)  # what JAX compiles here is small

R0, PEAK = TURN.as_matrix(), NUMBERS["load[1].sine"]
RANDOM = np.random.default_rng(7)
WEIGHTS = {"rotation": RANDOM.normal(size=(3, 3, 3)), "material_angular_velocity": RANDOM.normal(size=(3, 3))}
GRID = {"t_end": 1.0, "step": 0.25, "store": 2}
ALL = {name: NUMBERS[name] for name in LOADED} | {"load_scale": 0.9, "duration": 1.1}
ALL |= {"material_angular_velocity": W0, "rotation": R0, "inertia": J, "dead_force": DEAD}


@jax.jit
def measured(states):
    """A number that depends on all states, and not on them linearly."""
    linear = sum(jnp.sum(WEIGHTS[name] * states[name]) for name in WEIGHTS)
    return linear + 0.1 * jnp.sum(states["material_angular_velocity"] ** 2 * states["rotation"][:, 2])


def hat(d):
    return np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]])


@pytest.fixture(scope="module")
def everything():
    """The function of all parameters, of a body and a load with other numbers."""
    other = NUMBERS | {"load[0].values": np.zeros((5, 3)), "load[1].sine": PEAK[::-1], "load[1].frequency": 0.5}
    other |= {"load[1].phase": 0.0, "load[2].damping": np.eye(3), "load[3].rotor": [0, 0, 1]}
    system = nt.DirectorSystem(np.eye(3), None, np.zeros((3, 3)))
    return function(system, load=loaded("all", other), order=4, **GRID)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
def test_values_of_a_run(everything):
    found = everything(ALL)
    how = {"order": 4, "t_end": 1.1, "step": 0.275, "store": 2, "rotation": R0, "material_angular_velocity": W0}
    run = nt.integrate(nt.DirectorSystem(euler_inertia(J), None, DEAD), load=loaded("all", NUMBERS | ALL), **how)
    np.testing.assert_allclose(found["rotation"], run.rotation.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(found["material_angular_velocity"], run.material_angular_velocity, atol=1e-14)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
def test_derivatives_by_differences(everything):
    """One direction through all of them, forward; and its product with the gradient, which is carried back."""
    random = np.random.default_rng(11)
    d = random.normal(size=3)
    change = {name: random.normal(size=np.shape(value)) for name, value in ALL.items()} | {"rotation": R0 @ hat(d)}
    change["inertia"] = change["inertia"] + change["inertia"].T

    def moved(e):
        far = {name: value + e * change[name] for name, value in ALL.items()}
        return far | {"rotation": R0 @ nt.rotations.exp(e * d)}

    start = jax.tree.map(jnp.asarray, (ALL, change))
    f = jax.jit(lambda p: measured(everything(p)))
    along = jax.jit(lambda t: jax.jvp(f, (start[0],), (t,))[1])
    slope = along(start[1])
    e = 1e-3
    rise = [float(f(moved(k * e)) - f(moved(-k * e))) for k in (1, 2, 3)]
    expected = (45 * rise[0] - 9 * rise[1] + rise[2]) / (60 * e)  # of order 6
    assert abs(slope - expected) < 1e-10 * abs(expected)
    back = jax.jit(jax.grad(f))(start[0])
    terms = {name: np.sum(back[name] * change[name]) for name in ALL}
    assert abs(sum(terms.values()) - slope) < 1e-12 * sum(map(abs, terms.values()))
    zero = {name: np.zeros(np.shape(value)) for name, value in ALL.items()}
    assert abs(jax.jvp(along, (zero,), (start[1],))[1] - slope) < 1e-14 * abs(slope)  # the derivative is linear
    two = jax.vmap(along)(jax.tree.map(lambda x: jnp.stack([x, 3 * x]), start[1]))  # fewer than parameters
    assert abs(two - np.array([slope, 3 * slope])).max() < 1e-12 * sum(map(abs, terms.values()))


@pytest.mark.parametrize(("mode", "scheme"), [(jax.jacrev, "gauss"), (jax.jacfwd, "energy-momentum")])
def test_modes_are_our_derivatives(mode, scheme):
    system, how = nt.suslov(J, (1, 2, 2)), {"integrator": scheme, "load": nt.sine(PEAK, 0.7), "rotation": R0, **GRID}
    n = system.axis
    W, names = W0 - (W0 @ n) * n, ["material_angular_velocity", "inertia", "axis", "load_scale"]
    d = nt.sensitivities(system, wrt=names, material_angular_velocity=W, **how)
    run = function(system, project=True, **how)
    point = {"material_angular_velocity": W, "inertia": J, "axis": n, "load_scale": 1.0}
    ours, found = d.d_material_angular_velocity.values, jax.jit(mode(run))(point)
    by = jax.tree.map(np.asarray, found["material_angular_velocity"])
    entries = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
    both = np.stack([by["inertia"][..., i, j] + (i != j) * by["inertia"][..., j, i] for i, j in entries], -1)
    every = [by["material_angular_velocity"], both, by["axis"], by["load_scale"][..., None]]
    assert abs(np.concatenate(every, axis=-1) - ours).max() < 1e-13 * abs(ours).max()
    by = np.asarray(found["rotation"]["material_angular_velocity"])
    turned = np.einsum("nji,njkp->nikp", run(point)["rotation"], by)
    assert abs(turned + turned.swapaxes(1, 2)).max() < 1e-13  # Λᵀ dΛ is skew
    assert abs(turned[:, [2, 0, 1], [1, 2, 0]] - d.d_rotation.values[:, :, :3]).max() < 1e-13


def test_a_prescribed_spin():
    system = nt.nontwisting([3, 4, 5], spin=([0, 0.5, 1], [1, 2, 1]))
    f = attitude_of(function(system, material_angular_velocity=(1, 0.5, 0), **GRID))
    spin, t = np.array([1, 3, 0.5]), np.array([0.2, -0.5, 1])
    near, far = (f({"spin": spin + e * t}) - f({"spin": spin - e * t}) for e in (1e-3, 2e-3))
    slope = jax.jvp(lambda s: f({"spin": s}), (spin,), (t,))[1]
    assert abs(slope - (8 * near - far) / 12e-3) < 1e-9 * abs(slope)


@pytest.mark.parametrize("factor", [1.3, 0.0])
def test_factor_beside_wheels(factor):
    """It multiplies what depends on the state as well; fields have their own shapes, and a wheel has an inertia."""
    forces, C = np.stack([J, J.T @ J / 5]), np.diag([1.0, 2, 0.5]) + 0.1
    load = nt.wheel((1, 2, 2), 0.2, 9, 0.3) + nt.director_forces([0, 2], forces) + nt.potential((0, 0, 1), quadratic=C)
    point = {"load_scale": np.array(factor), "load[0].inertia": np.array(0.2)}
    point |= {"load[1].values": forces, "load[2].quadratic": C}
    f = attitude_of(function(nt.standard(J), load=load, material_angular_velocity=W0, **GRID))
    for name, value in point.items():
        t = np.random.default_rng(3).normal(size=value.shape)
        t = t + t.T if "quadratic" in name else t
        near, far = (f(point | {name: value + e * t}) - f(point | {name: value - e * t}) for e in (1e-3, 2e-3))
        slope = jax.jvp(lambda x, name=name: f(point | {name: x}), (value,), (t,))[1]
        assert abs(slope - (8 * near - far) / 12e-3) < 1e-8 * (1 + abs(slope)), name
        assert abs(jnp.sum(jax.grad(f)(point)[name] * t) - slope) < 1e-12 * (1 + abs(slope)), name


def attitude_of(run):
    return lambda p: measured(run(p))


@pytest.fixture(scope="module")
def plain():
    return function(nt.standard(J), load=nt.sine(PEAK, 0.7), rotation=R0, **GRID)


def test_a_start_alone(plain):
    """It is prepared; beside a parameter of the body, which runs are made for anew, the derivatives are the same."""
    start, f = {"material_angular_velocity": W0, "rotation": R0}, attitude_of(plain)
    change = {"material_angular_velocity": np.array([1, -2, 0.5]), "rotation": R0 @ hat(np.array([0.3, 1, -1]))}
    beside = [lambda p, rest=rest: f(p | rest) for rest in ({}, {"inertia": J})]
    for found in (lambda g: jax.grad(g)(start), lambda g: jax.jvp(g, (start,), (change,))[1]):
        alone, other = (np.hstack([np.ravel(x) for x in jax.tree.leaves(found(g))]) for g in beside)
        assert abs(alone - other).max() < 1e-13 * abs(other).max() > 0


STARTS, BODIES = RANDOM.normal(size=(4, 3)), J + 0.1 * np.arange(4)[:, None, None] * np.eye(3)


def test_compiled_and_mapped_bits(plain):
    """Of values and gradients; what is mapped by `vmap`, once or twice, is what a loop gives."""
    points, f = {"material_angular_velocity": STARTS, "inertia": BODIES}, attitude_of(plain)
    each = [{name: values[k] for name, values in points.items()} for k in range(4)]
    alone, compiled, mapped = [plain(p) for p in each], jax.jit(plain), jax.vmap(plain)(points)
    for name in WEIGHTS:
        assert all(np.array_equal(one[name], compiled(p)[name]) for one, p in zip(alone, each, strict=True))
        assert np.array_equal(mapped[name], [one[name] for one in alone])
    slopes = jax.grad(f)(each[2])
    one, many = slopes["inertia"], jax.jit(jax.vmap(jax.grad(f)))(points)["inertia"][2]
    listed = jax.grad(lambda x: f(each[2] | {"material_angular_velocity": [x, *STARTS[2, 1:]]}))(STARTS[2, 0])
    assert listed == pytest.approx(float(slopes["material_angular_velocity"][0]), rel=1e-14)
    assert np.array_equal(one, jax.jit(jax.grad(f))(each[2])["inertia"])
    assert abs(many - one).max() < 1e-14 * abs(one).max()  # the loss is compiled in other words
    twice = jax.vmap(jax.vmap(lambda W, J: plain({"material_angular_velocity": W, "inertia": J}), (0, None)), (None, 0))
    found, point = twice(STARTS[:2], BODIES)["rotation"], {"material_angular_velocity": STARTS[1], "inertia": BODIES[2]}
    assert found.shape == (4, 2, 3, 3, 3)
    assert np.array_equal(found[2, 1], plain(point)["rotation"])


@pytest.mark.parametrize(("name", "load"), [("wheel", nt.wheel("z", 0.1, speed=9)), ("rotor", nt.rotor("z", 0.9))])
def test_axes_of_any_length(name, load):
    f, n = (
        attitude_of(function(nt.standard(J), load=load, material_angular_velocity=W0, **GRID)),
        np.array([1, 2, 2]) / 3,
    )
    slope, longer = (jax.grad(lambda axis: f({name: axis}))(length * n) for length in (1, 7))
    assert abs(slope - 7 * longer).max() < 1e-12 * abs(slope).max()


def test_matrices_and_axes_are_extended():
    """By what their docstring says: the nearest rotation, the symmetric part, the direction."""
    random, n = np.random.default_rng(13), np.array([1, 2, 2]) / 3
    run = function(nt.suslov(J, n), project=True, material_angular_velocity=W0, load=nt.sine(PEAK, 0.7), **GRID)
    f, point = attitude_of(run), {"rotation": R0, "inertia": J, "axis": 7 * n}
    assert f({**point, "inertia": J + 1e-7 * hat([1, 2, 3])}) == pytest.approx(float(f(point)), rel=1e-14)
    g = jax.jit(jax.grad(f))(point)
    assert abs(R0.T @ g["rotation"] + (R0.T @ g["rotation"]).T).max() < 1e-13
    assert np.array_equal(g["inertia"], g["inertia"].T)
    assert abs(g["axis"] @ n) < 1e-13
    one, slope = jax.value_and_grad(lambda n: f({**point, "axis": n}))(n)
    assert abs(one - f(point)) < 1e-13 * abs(one)
    assert abs(slope - 7 * g["axis"]).max() < 1e-12 * abs(slope).max()
    t = {name: random.normal(size=value.shape) for name, value in point.items()}  # leaves what is possible
    terms = [np.sum(slope * t[name]) for name, slope in g.items()]
    assert abs(jax.jvp(f, (point,), (t,))[1] - sum(terms)) < 1e-12 * sum(map(abs, terms))

    def nearest(e):
        U, _, V = np.linalg.svd(R0 + e * t["rotation"])
        return f({**point, "rotation": U @ V})

    expected = (8 * (nearest(1e-4) - nearest(-1e-4)) - nearest(2e-4) + nearest(-2e-4)) / 12e-4
    assert np.sum(g["rotation"] * t["rotation"]) == pytest.approx(float(expected), rel=1e-8)


def test_principal_moments_with_axes(plain):
    Q, moments = np.linalg.eigh(J)[1], np.array([2.5, 4.5, 6])
    one, same = plain({"principal_inertia": moments}), plain({"inertia": (Q * moments) @ Q.T})
    assert all(abs(one[name] - same[name]).max() < 1e-14 for name in WEIGHTS)


def test_second_derivatives_are_refused(plain):
    for second in (jax.hessian, lambda f: jax.grad(lambda x: jax.grad(f)(x)[0])):
        with says(NotImplementedError):
            jax.make_jaxpr(second(lambda W: plain({"material_angular_velocity": W})["rotation"][-1, 0, 0]))(W0)


def called(params):
    return lambda: function(nt.standard(J), load=nt.sine(PEAK, 0.7) + nt.sine(PEAK, 0.3), **GRID)(params)


test_wrong_parameters_and_plans = refused_as(
    {
        "unknown": called({"inertai": J}),
        "two terms": called({"sine": PEAK}),
        "shape": called({"material_angular_velocity": jnp.zeros(2)}),
        "both": called({"inertia": J, "principal_inertia": [3, 4, 5]}),
        "body": called({"inertia": -J}),
        "duration": called({"duration": 0}),
        "no dictionary": called([W0]),
        "no step": lambda: function(nt.standard(J), **GRID | {"step": None}),
    }
)


def test_errors_of_compiled_functions(plain, monkeypatch):
    with pytest.raises(RuntimeError, match="inertia is not positive definite"):
        jax.block_until_ready(jax.jit(plain)({"inertia": -J}))
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match=re.escape("64-bit numbers, which JAX has disabled: jax.config.update(")):
            plain({"material_angular_velocity": W0})
    finally:
        jax.config.update("jax_enable_x64", True)
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(ImportError, match=r"^nontwist.jax needs JAX: pip install 'nontwist\[jax\]'$"):
        function(nt.standard(J), **GRID)
