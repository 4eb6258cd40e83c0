"""Lyapunov exponents: closed forms, sums, and the growth of the tangents of `sensitivities`."""

import ctypes
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from nontwist.engine import linearised
from nontwist.engine.known_steps import LANES, Steps
from nontwist.kernels import machine_code
from nontwist.kernels.memory import View, doubles, view_of

J = np.array([[3, 0.1, -0.2], [0.1, 4, 0.15], [-0.2, 0.15, 5]])
C = np.array([[0.1, 0.02, 0], [0.02, 0.2, 0.03], [0, 0.03, 0.3]])
W0 = (0.4, -1.1, 0.7)


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_rate_of_the_middle_axis(scheme):
    """Neighbours of a rotation about the middle axis leave it like ``exp(σt)``, σ² = W² (J3-J2)(J2-J1)/(J1 J3)."""
    how = {"t_end": 200, "step": 0.02, "material_angular_velocity": (0, 2, 0), "integrator": scheme}
    found = nt.lyapunov(nt.standard([3, 4, 5]), **how).lyapunov_exponent
    rate = 2 / np.sqrt(15)
    growth = (found * found.time).values
    late = (growth[-1] - growth[len(growth) // 2]) / (found.time.values[-1] - found.time.values[len(growth) // 2])
    assert abs(late[[0, -1]] - [rate, -rate]).max() < (1e-9 if scheme == "gauss" else 1e-4)
    assert abs(late[1:-1]).max() < 0.02
    assert (found.units, found.sizes["exponent"]) == ("s-1", 6)


HIDDEN = "energy-momentum hides exponents below zero; use gauss or lie-midpoint for these"


@pytest.mark.filterwarnings(f"ignore:{HIDDEN}")
@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_sums_are_volume_growth(scheme):
    how = {"t_end": 20, "step": 0.05, "material_angular_velocity": W0, "integrator": scheme}
    damped = nt.lyapunov(nt.standard(J), load=nt.damping(C), **how).lyapunov_exponent.values[-1].sum()
    assert abs(damped + np.trace(np.linalg.solve(J, C))) < (1e-12 if scheme == "gauss" else 1e-3)
    for load in (nt.gravity_gradient(1.3), nt.spring(3.0, (0, 0.2, 1), (1, 0.5, 1), 0.8)):
        found = nt.lyapunov(nt.standard(J), load=load, **how).lyapunov_exponent
        assert abs(found.sum("exponent").values).max() < (1e-12 if scheme == "gauss" else 5e-3)  # a volume stays
    heavy = nt.lyapunov(nt.heavy_top(J, 1, (0.1, 0.2, 0.5)), **how).lyapunov_exponent.values
    if scheme != "energy-momentum":  # of whose twelve directions these are six
        d = nt.sensitivities(nt.heavy_top(J, 1, (0.1, 0.2, 0.5)), wrt=["rotation", "material_angular_velocity"], **how)
        X = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
        assert abs(20 * heavy[-1].sum() - np.log(abs(np.linalg.det(X)))) < 1e-11


@pytest.mark.parametrize("turn", [1.0, 3.0])
def test_strong_damping(turn):
    """-c/J_i as a step of order 8 has it, R(-h c/J), also where round-off of what grows hides it within few steps."""
    how = {"t_end": 1280 * turn / 1e3, "step": turn / 1e3, "order": 8, "load": nt.damping(1e3)}
    found = nt.lyapunov(nt.standard([1, 2, 3]), material_angular_velocity=(1, 2, 3), **how).lyapunov_exponent
    growth = (found * found.time).values[:, 3:]
    middle = len(growth) // 2
    late = (growth[-1] - growth[middle]) / (found.time.values[-1] - found.time.values[middle])
    z = turn / np.array([3, 2, 1])
    by_step = np.polyval([1, -20, 180, -840, 1680], z) / np.polyval([1, 20, 180, 840, 1680], z)
    assert late == pytest.approx(np.log(by_step) * 1e3 / turn, rel=1e-11)
    assert late == pytest.approx(-1e3 * z / turn, rel=4e-4)


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_suslov_volumes_shrink(scheme):
    """tr(S ∂(JW × W)/∂W) over the changes across n, the mean over a long run, about an axis that is oblique."""
    inertia, n = np.array([[2, 0.1, 0.3], [0.1, 2.5, -0.2], [0.3, -0.2, 3]]), np.array([0, 0.6, 0.8])
    how = {"t_end": 100, "step": 0.02, "material_angular_velocity": (1, 0.8, -0.6), "integrator": scheme}
    across = np.linalg.svd(n[None])[2][1:].T
    S = across @ np.linalg.inv(across.T @ inertia @ across) @ across.T
    W = nt.simulate(nt.suslov(inertia, n), **how).material_angular_velocity.values
    terms = [np.cross(inertia @ e, W) + np.cross(W @ inertia, e) for e in across.T]
    divergence = sum(term @ S @ e for term, e in zip(terms, across.T, strict=True))
    found = nt.lyapunov(nt.suslov(inertia, n), **how).lyapunov_exponent
    assert found.sizes["exponent"] == 5
    assert divergence.mean() < -0.2
    for k in (50, 100, 156):  # orthonormalisations, each after 32 steps
        expected = np.trapezoid(divergence[: 32 * k + 1], dx=0.02) / (0.64 * k)
        assert found.time.values[k - 1] == pytest.approx(0.64 * k)
        assert found.values[k - 1].sum() == pytest.approx(expected, rel=1e-5)


@pytest.mark.long
def test_chaos_of_a_heavy_top():
    top, how = nt.heavy_top([3, 2.5, 1], 1, (0.1, 0.2, 1)), {"t_end": 300, "step": 0.05}
    chaotic = nt.lyapunov(top, material_angular_velocity=(1, 2, 1), **how).lyapunov_exponent.values
    assert chaotic[-1, 0] > 0.3
    assert abs(chaotic[-1] + chaotic[-1, ::-1]).max() < 0.05  # pairs


KICK = nt.body_moment([0, 1, 2, 3], np.array([[0, 0, 0], [0.3, 0, 0.1], [0, 0.4, 0], [0, 0, 0]]))
STARTS = np.random.default_rng(4).normal(size=(9, 3))


@pytest.mark.filterwarnings(f"ignore:{HIDDEN}")
@pytest.mark.parametrize(
    ("bodies", "W", "how"),
    [
        (nt.heavy_top(J, 1, (0.1, 0.2, 0.5)), STARTS, {"integrator": "lie-midpoint"}),
        ([nt.standard(k * J) for k in range(1, 10)], STARTS, {"integrator": "gauss", "order": 4, "load": KICK}),
        ([nt.suslov(J, n) for n in STARTS], (0, 0, 0), {"integrator": "lie-midpoint", "load": KICK}),
        (nt.standard(J), STARTS, {"integrator": "energy-momentum", "load": nt.damping(C), "load_scale": np.arange(9)}),
    ],
)
def test_members_equal_lyapunov(bodies, W, how):
    """Bit for bit, however many threads there are: of one body or many, and under factors of a load."""
    how = {"t_end": 5, "step": 0.05, "rotation": Rotation.random(9, rng=1), **how}
    systems = nt.DirectorSystem.stack(bodies) if isinstance(bodies, list) else bodies
    found = nt.lyapunov_ensemble(systems, material_angular_velocity=W, threads=2, **how)
    assert found.lyapunov_exponent.dims == ("member", "exponent")
    turned, scale, load = how.pop("rotation"), how.pop("load_scale", np.ones(9)), how.pop("load", None)
    for i in range(9):
        body = bodies[i] if isinstance(bodies, list) else bodies
        start = {"rotation": turned[i], "material_angular_velocity": np.broadcast_to(W, (9, 3))[i]}
        one = nt.lyapunov(body, load=None if load is None else scale[i].item() * load, **start, **how)
        assert (one.lyapunov_exponent.values[-1] == found.lyapunov_exponent.values[i]).all()


def test_failing_members():
    W = np.tile([1.0, -2, 0.5], (20, 1))
    W[4] *= 1e3
    how = {"t_end": 1, "step": 0.01, "material_angular_velocity": W, "integrator": "lie-midpoint"}
    with pytest.warns(UserWarning, match="^1 of 20 members have failed, the first is 4: step 0 at t = 0 s: the body"):
        found = nt.lyapunov_ensemble(nt.standard(J), **how)
    for bad in (np.isnan(found.lyapunov_exponent.values).any(axis=1), found.status.values, found.message.values != ""):
        assert bad.nonzero()[0].tolist() == [4]
    with pytest.raises(ValueError, match=r"^exact has no derivatives; those that have them are gauss, "):
        nt.lyapunov_ensemble(nt.standard(J), **how | {"integrator": "exact", "step": None})


WARNED = {
    "does not resolve": ({"load": nt.damping(1e4), "step": None}, "decays at up to 1e\\+04 1/s, whose exponents are"),
    "director scheme": ({"integrator": "energy-momentum"}, f"^{HIDDEN}$"),
    "breakpoints": ({"load": nt.pulse((1, 0, 0), 0.25, 0.55)}, "breakpoint"),
}


@pytest.mark.parametrize("case", WARNED)
@pytest.mark.parametrize("function", [nt.lyapunov, nt.lyapunov_ensemble])
def test_missed_exponents_warn_the_caller(function, case):
    more, words = WARNED[case]
    with pytest.warns(UserWarning, match=words) as told:
        function(nt.standard([1, 2, 3]), **{"t_end": 1, "step": 0.1, "material_angular_velocity": (1, 2, 3)} | more)
    assert (len(told), told[0].filename) == (1, __file__)


def test_ensembles_choose_steps_as_runs():
    how = {"t_end": 3, "material_angular_velocity": STARTS}
    many = nt.simulate_ensemble(nt.standard(J), tolerance=1e-6, **how)
    found = nt.lyapunov_ensemble(nt.standard(J), tolerance=1e-6, **how)
    assert found.step == many.step
    again = nt.lyapunov_ensemble(nt.standard(J), step=many.step, order=json.loads(many.integrator)["order"], **how)
    assert (again.lyapunov_exponent.values == found.lyapunov_exponent.values).all()


@pytest.mark.parametrize(("rows", "count", "how"), [(6, 5, "__call__"), (6, 5, "on_floats"), (12, 3, "__call__")])
def test_growth_by_qr(rows, count, how):
    rng, together = np.random.default_rng(rows + count), 17
    steps = 2 * together
    M, n = np.eye(rows, rows + 2) + 0.1 * rng.normal(size=(steps, rows, rows + 2)), rng.normal(size=rows)
    G, x, lengths, length = np.eye(rows), rng.normal(size=(rows, LANES)), np.zeros((2, count)), np.linalg.norm(n)
    metric, memory = np.eye(6) + np.cov(rng.normal(size=(6, 20))), np.zeros((rows, rows + 2, LANES))

    @machine_code.KIND
    def make(address):
        k = View(Steps, doubles(address)).first
        memory[:, :, : len(M[k : k + LANES])] = np.moveaxis(M[k : k + LANES], 0, -1)

    b = view_of(Steps)
    b.steps, b.batches, b.width, b.grown, b.together = steps, -(-steps // LANES), rows + 2, count, together
    b.make, b.out = ctypes.cast(make, ctypes.c_void_p).value, memory
    b.weights, b.metric, b.normal = np.linspace(1, 2, 6), metric, n / length
    b.state, b.lengths = x.copy(), lengths
    getattr(linearised.grow(rows), how)(b.address)
    G[:6, :6], G[6:, 6:] = np.diag(np.linspace(1, 2, 6)), metric[: rows - 6, : rows - 6]
    first = x[:, :count]
    for k in range(2):
        for A in M[k * together : (k + 1) * together]:
            first = A[:, :rows] @ first
        first = first - np.outer(n, n @ G @ first) / (length * length)
        R = np.linalg.qr(np.linalg.cholesky(G).T @ first)[1]
        assert lengths[k] == pytest.approx(abs(np.diag(R)), rel=1e-11)
        first = first @ np.linalg.inv(R)
