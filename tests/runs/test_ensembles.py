"""Many runs at once: each is the run of `simulate`, bit for bit the same in any company and any number of threads."""

import re
import tracemalloc
from contextlib import nullcontext

import numpy as np
import pytest
import xarray
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, PAPER_J, STANDARD, random_inertia
from nontwist.analysis.statistics import STATISTICS
from nontwist.comparison import second_quotient
from nontwist.errors import SimulationError
from nontwist.integrators import stack_march
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum
from nontwist.viewer.content import content
from refusals import refused_as, says, warned

RNG = np.random.default_rng(8)
M = 17


def tops(rng):
    rho = rng.normal(size=3) / 4
    return nt.heavy_top(
        random_inertia(rng) + 2 * (rho @ rho * np.eye(3) - np.outer(rho, rho)), 2.0, rho, rng.normal(size=3) * 5
    )


RANDOM = {
    "standard": lambda rng: nt.standard(random_inertia(rng)),
    "nontwisting": lambda rng: nt.nontwisting(random_inertia(rng, block=True)),
    "suslov": lambda rng: nt.suslov(random_inertia(rng), rng.normal(size=3)),
    "top": tops,
}
LOADS = {
    "none": None,
    "body": nt.body_moment(lambda t: (np.sin(3 * t), 1, 0.3)),
    "space": nt.space_moment(lambda t: (np.sin(3 * t), -1, 0.3)),
    "sum": nt.damping([0.1, 0.2, 0.3]) + nt.sine([1, 2, 0], 0.7) + nt.space_moment(lambda t: (1, t / 5, -1)),
}


def problem(name, load="none", m=M, seed=0):
    """A stack of random bodies with random starts and factors of the load."""
    rng = np.random.default_rng([seed, *name.encode(), *load.encode()])
    bodies = [RANDOM[name](rng) for _ in range(m)]
    start = {"rotation": Rotation.random(m, rng=rng), "material_angular_velocity": 2 * rng.normal(size=(m, 3))}
    return bodies, {**start, "project": True, "load": LOADS[load], "load_scale": rng.normal(size=m)}


def one(bodies, arguments, i, **how):
    """The run of one member through `integrate`."""
    own = {key: value for key, value in arguments.items() if key not in ("load", "load_scale")}
    own |= {key: own[key][i] for key in ("rotation", "material_angular_velocity")}
    load = arguments["load"]
    return nt.integrate(bodies[i], **own, load=None if load is None else arguments["load_scale"][i] * load, **how)


def test_free_bodies_keep_invariants():
    bodies, arguments = problem("standard")
    many = nt.simulate_ensemble(bodies, **arguments, t_end=1, step=0.01, order=4, reduce=["drift", "extrema"])
    assert (many.energy_drift / many.kinetic_energy_max).max() <= 1e-12
    assert (many.momentum_drift / abs(many.spatial_momentum_max).max("axis")).max() <= 1e-12
    assert many.momentum_drift.long_name.endswith("of the spatial angular momentum")


def same_bits(one, other):
    xarray.testing.assert_identical(one.drop_attrs(), other.drop_attrs())


MIXED = [RANDOM[name](np.random.default_rng(k)) for k, name in enumerate(["standard", "top"] * 8 + ["standard"])]


@pytest.mark.parametrize("scheme", [{}, {"integrator": "split", "order": 6}], ids=["gauss", "split"])
def test_other_members_change_no_bit(scheme, monkeypatch):
    """Members alone, in blocks of odd sizes, among other bodies, in threads, and with the time cut into pieces."""
    _, arguments = problem("standard", "body", 17)
    how = {"t_end": 0.5, "step": 0.01, "reduce": STATISTICS, "store": 7, "variables": "all", **scheme}
    whole = nt.simulate_ensemble(nt.DirectorSystem.stack(MIXED), **arguments, **how)
    names = ["quaternion", "spatial_momentum", "kinetic_energy", "energy_drift", "spatial_momentum_max", "total_twist"]
    for k in (2, 16):
        cut = {key: arguments[key][k:] for key in ("rotation", "material_angular_velocity", "load_scale")}
        part = nt.simulate_ensemble(nt.DirectorSystem.stack(MIXED[k:]), **arguments | cut, **how)
        rest = whole[names].isel(member=slice(k, None))
        same_bits(part[names], rest.assign_coords(member=np.arange(M - k)))
    monkeypatch.setattr(stack_march, "NODES", 60)
    for threads in (1, 3):
        same_bits(nt.simulate_ensemble(nt.DirectorSystem.stack(MIXED), **arguments, **how, threads=threads), whole)


def test_failing_member_stops_no_other():
    """One turns too far at once, one in the middle of the run; message and time are those of `simulate`."""
    W, scale = np.tile([1.0, -2, 0.5], (20, 1)), np.ones(20)
    W[4], scale[11] = 1e3 * W[4], 2e3
    how = {"t_end": 1, "step": 0.01, "integrator": "lie-midpoint", "load": nt.sine([1, 2, 0], 0.7)}
    kept = {"store": 10, "reduce": ["drift", "averages"]}
    text = "2 of 20 members have failed, the first is 4: step 0 at t = 0 s: the body turns 13 rad in one step"
    with pytest.warns(UserWarning, match=re.escape(text)):
        many = nt.simulate_ensemble(nt.standard(PAPER_J), material_angular_velocity=W, load_scale=scale, **how, **kept)
    assert np.flatnonzero(many.status).tolist() == np.flatnonzero(many.message != "").tolist() == [4, 11]
    assert many.attrs["message"].startswith(text)
    with pytest.raises(SimulationError) as error:
        nt.integrate(nt.standard(PAPER_J), material_angular_velocity=W[11], **{**how, "load": 2e3 * how["load"]})
    assert many.message.values[11] == str(error.value)
    reached = int(error.value.time / 0.1 + 1e-9) + 1
    assert 2 <= reached < 10
    assert np.isfinite(many.quaternion[11, :reached]).all()
    assert np.isnan(many.quaternion[11, reached:]).all()
    for name in ("material_angular_velocity", "kinetic_energy_mean", "energy_drift"):
        assert np.isnan(many[name].values.reshape(20, -1)).any(axis=1).nonzero()[0].tolist() == [4, 11]
    alone = nt.simulate_ensemble(nt.standard(PAPER_J), material_angular_velocity=W[5], **how, **kept)
    same_bits(alone, many.drop_vars(["message", "load_scale"]).isel(member=[5]).assign_coords(member=[0]))


def test_load_ends_all(monkeypatch):
    load = nt.space_moment(lambda t: (1, 0, 0) if t < 0.5 else (np.nan, 0, 0))
    how = {"t_end": 1, "step": 0.01, "order": 2, "material_angular_velocity": [[1, 2, 3], [1, 0, 0]], "load": load}
    with pytest.raises(ValueError, match=r"is not finite at t = 0\.505 s"):
        nt.simulate_ensemble(nt.standard(PAPER_J), **how)
    monkeypatch.setattr(stack_march, "NODES", 30)
    with pytest.warns(UserWarning, match=r"2 of 2 members have failed, .* is not finite at t = 0\.505 s"):
        many = nt.simulate_ensemble(nt.standard(PAPER_J), **how, store=10, reduce="drift")
    assert np.isfinite(many.quaternion[:, :4]).all()
    assert np.isnan(many.quaternion[:, 4:]).all()
    assert np.isnan(many.energy_drift).all()


def given(system=None, **case):
    return lambda: nt.simulate_ensemble(system or nt.standard(PAPER_J), **{"t_end": 0.1, "step": 0.01, **case})


THREE, SKEW = nt.DirectorSystem.stack([nt.standard(PAPER_J)] * 3), nt.suslov([3, 4, 5], [1, 1, 1])
test_refused_with_the_value = pytest.mark.filterwarnings("ignore:the load")(
    refused_as(
        {
            "lengths": given(material_angular_velocity=np.ones((5, 3)), load_scale=np.ones(4)),
            "stack": given(THREE, rotation=Rotation.random(2, rng=RNG)),
            "empty": given(material_angular_velocity=np.ones((0, 3))),
            "velocity": given(angular_velocity=np.ones((5, 2))),
            "not finite": given(angular_velocity=[[1, 0, 0], [1, np.nan, 0]]),
            "scale": given(load_scale=np.ones((2, 2))),
            "spin": given(nt.nontwisting(PAPER_J), material_angular_velocity=[[1, 2, 0], [1, 2, 0.5]]),
            "variable": given(variables=["speed"]),
            "interval": given(variables="load_work"),
            "reduction": given(reduce="mean"),
            "exact": given(integrator="exact", reduce="drift"),
            "threads": given(threads=0),
            "state": given(step=None, load=nt.moment(lambda t, d, w: -w), integrator="lie-midpoint"),
            "start": given(start=np.eye(3)),
            "closed form": given(SKEW, integrator="exact", step=None, load_scale=[1, 1]),
            "no body": given(nt.DirectorSystem.stack),
        }
    )
)


def test_wrong_body_is_named():
    E, bodies = np.tile(np.diag([1.0, 2, 3]), (4, 1, 1)), [RANDOM["suslov"](RNG) for _ in range(3)]
    E[2, 0, 0] = -0.5
    for call in (
        lambda: nt.DirectorSystem.stack([nt.standard(PAPER_J), nt.nontwisting(PAPER_J)]),
        lambda: nt.DirectorSystem.stack([]),
        lambda: nt.SystemStack(E),
    ):
        with says():
            call()
    stack = nt.DirectorSystem.stack(bodies)
    assert [stack[i].to_json() for i in range(len(stack))] == [body.to_json() for body in bodies]
    again = nt.SystemStack(stack.euler_inertia, stack.axis * [[1], [2], [3]], stack.dead_force, "suslov")
    assert again.axis == pytest.approx(stack.axis, abs=1e-15)


@pytest.mark.parametrize(
    ("name", "integrator"), [("suslov", "lie-midpoint"), ("top", "energy-momentum"), ("nontwisting", "split")]
)
def test_statistics_of_the_full_run(name, integrator):
    """Also where nothing acts any more, and nothing is integrated."""
    bodies, arguments = problem(name, "sum" if name == "suslov" else "body", 5)
    if name == "nontwisting":
        arguments["load"] = nt.pulse((1, 2, 0), 0.6, 1.1)
    how = {"t_start": 0.5, "t_end": 2.5, "step": 0.01, "order": 2, "integrator": integrator}
    if name == "top":
        arguments["load"] += nt.spring(3.0, (0.1, 0.2, 0.3), (1, -2, 4))
    many = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), **arguments, **how, reduce=STATISTICS)
    names = ["kinetic_energy", "spatial_momentum", "material_momentum", "twist_rate"]
    names += ["potential_energy"] if name == "top" else ["reaction_moment"]
    for i in (0, 4):
        run, mine = one(bodies, arguments, i, **how).to_dataset(), many.isel(member=i)
        for key in names:
            dim, close = run[key].dims[0], {"rel": 1e-12, "abs": 1e-11 * max(1, float(abs(run[key]).max()))}
            mean = run[key].mean(dim) if dim == "midtime" else run[key].integrate("time") / 2
            for kind, expected in (("min", run[key].min(dim)), ("max", run[key].max(dim)), ("mean", mean)):
                by_gauss = integrator == "split" and kind == "mean"  # and not by the trapezoidal rule
                how_close = {"rel": 1e-5, "abs": 1e-5} if by_gauss else close
                assert mine[f"{key}_{kind}"].values == pytest.approx(expected.values, **how_close)
        assert float(mine.total_twist) == pytest.approx(float(run.twist_rate.integrate("time")), abs=1e-11)
        assert float(mine.energy_drift) <= 1e-12 * float(run.kinetic_energy.max())
    assert ("reaction_moment_min" in many, "momentum_drift" in many) == (name != "top", False)
    assert ("potential_energy_min" in many) == ("dead_force" in many) == (name == "top")


def test_the_drift_is_seen():
    """A body under damping: its energy falls by the work; a stretched step keeps the sum, so the drift is round-off."""
    how = {"t_end": 1, "step": 0.01, "material_angular_velocity": [1, 2, 3], "load": nt.damping(2.0)}
    many = nt.simulate_ensemble(nt.standard(PAPER_J), **how, reduce=["drift", "extrema"]).isel(member=0)
    assert float(many.kinetic_energy_max - many.kinetic_energy_min) > 1
    assert float(many.energy_drift) <= 1e-13 * float(many.kinetic_energy_max)
    how |= {"integrator": "split", "order": 2, "step": 0.1, "rotation": Rotation.from_rotvec([2, 0, 0]), "load": None}
    how["material_angular_velocity"] = np.array([[-4, -0.5, -2], [-0.5, -1.3, -2]])  # the energy falls, and rises
    many = nt.simulate_ensemble(BODIES["heavy_top"](), **how, reduce="drift", variables="all", store=1)
    energy = many.kinetic_energy + many.potential_energy  # which split does not keep under gravity
    assert many.energy_drift.values == pytest.approx(abs(energy - energy[:, 0]).max("time").values, rel=1e-12)


@pytest.mark.parametrize("order", [2, 6])
def test_order_of_integrals(order):
    how = {"t_end": 2, "material_angular_velocity": [1, -2, 3], "order": order, "reduce": ["averages", "total_twist"]}
    runs = [nt.simulate_ensemble(BODIES["heavy_top"](), step=2 / N, **how) for N in (25, 50)]
    fine = nt.simulate_ensemble(BODIES["heavy_top"](), step=0.004, **{**how, "order": 8})
    for name in ("total_twist", "potential_energy_mean", "material_momentum_mean"):
        errors = [float(abs(run[name] - fine[name]).max()) for run in runs]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35), name


def test_statistics_of_lanes():
    """A load of the state sends the members through `integrate`; the numbers stay."""
    load, more = nt.body_moment(lambda t: (np.sin(3 * t), 1, 0.3)), nt.moment(lambda t, d, w: 0 * w)
    bodies, arguments = problem("nontwisting", m=2)
    how = {"t_end": 1, "step": 0.02, "order": 4, "reduce": STATISTICS, "variables": "all", "store": 25}
    how |= {key: arguments[key] for key in ("rotation", "material_angular_velocity", "project")}
    many = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), load=load, **how)
    with pytest.warns(UserWarning, match="runs in Python"):
        other = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), load=load + more, **how)
    assert set(many.data_vars) == set(other.data_vars)
    for key in set(many.data_vars) - {"status"}:
        close, (a, b) = 1e-9 * float(1 + abs(many[key]).max()), (other[key].values, many[key].values)
        if key.endswith(("_min", "_max")):  # of the nodes alone, where functions run in Python
            assert ((a if key.endswith("max") else -a) <= (b if key.endswith("max") else -b) + close).all(), key
            close *= 1e5
        assert a == pytest.approx(b, abs=close), key


EXTREME = {
    "free": (nt.standard([3, 4, 5]), None),
    "top": (nt.heavy_top([2, 2, 0.5], mass=1, centre_of_mass=(0, 0, 1)), None),
    "driven": (nt.standard([3, 4, 5]), nt.sine((0, 1, 0), 0.7)),
}


@pytest.mark.parametrize("name", EXTREME)
def test_extrema_between_nodes(name):
    """As of steps so short that a parabola through the nodes has them; drift is that of the nodes."""
    body, load = EXTREME[name]
    how = {"material_angular_velocity": [[0.1, 2, 0.1], [1, 1, 1], [0, 0.3, 3]], "load": load, "t_end": 7}
    long = nt.simulate_ensemble(body, **how, order=16, step=0.25, reduce=("extrema", "drift"))
    fine = nt.simulate_ensemble(body, **how, order=8, step=1e-3, store=1, variables="all")
    assert long.energy_drift.max() < 1e-12
    for key in ("kinetic_energy", "potential_energy", "twist_rate", "spatial_momentum", "material_momentum"):
        if f"{key}_max" in long:
            y, size = fine[key].values, float(abs(fine[key]).max())
            before, now, after = y[:, :-2], y[:, 1:-1], y[:, 2:]
            slope, bend = (after - before) / 2, before - 2 * now + after
            top = now - slope**2 / (2 * np.where(bend == 0, 1, bend))
            inside = abs(slope) < abs(bend)
            most = np.maximum(y.max(axis=1), np.where(inside, top, -np.inf).max(axis=1))
            least = np.minimum(y.min(axis=1), np.where(inside, top, np.inf).min(axis=1))
            assert long[f"{key}_max"].values == pytest.approx(most, abs=1e-9 * size)
            assert long[f"{key}_min"].values == pytest.approx(least, abs=1e-9 * size)


@pytest.mark.parametrize("name", ["standard", "nontwisting"])
def test_closed_forms(name):
    bodies, arguments = problem(name, m=20)
    times, stack = np.append(np.linspace(0, 3, 16), 7.1), nt.DirectorSystem.stack(bodies)
    rotation, W = arguments["rotation"], arguments["material_angular_velocity"] * [1, 1, name != "nontwisting"]
    own = {"rotation": rotation, "material_angular_velocity": W, "project": True}
    many = nt.simulate_ensemble(stack, **own, integrator="exact", times=times, threads=2, variables="all")
    solution = nt.exact.free_standard if name == "standard" else nt.exact.free_nontwisting
    for i, J in enumerate(stack.convected_inertia):  # an ulp of J near a separatrix turns the body by many
        Lam, velocity = solution(J, W[i], times, rotation[i])
        ulps = 5e-15 * (1 + np.linalg.norm(W[i]) * times[-1])
        assert many.directors.values[i] == pytest.approx(Lam.swapaxes(1, 2), abs=ulps)
        assert many.material_angular_velocity.values[i] == pytest.approx(velocity, abs=ulps * abs(W[i]).max())
    before, after = many.quaternion.values[:, :15], many.quaternion.values[:, 1:16]
    assert np.sum(before * after, axis=2).min() > 0.8  # no jump of sign


def test_closed_form():
    """One by one: the turn about a fixed axis, of each member by its own impulse."""
    load, scale = nt.body_moment([0, 1, 2], [[0, 0, 0], [1, 2, 0], [0, 0, 0]]), np.array([-1, 0.5, 2])
    how = {"t_end": 3.0, "load": load, "load_scale": scale, "integrator": "exact"}
    many, impulse = nt.simulate_ensemble(nt.nontwisting([1, 1, 1.5]), **how), scale[:, None] * np.array([1, 2, 0])
    assert many.material_angular_velocity[:, -1].values == pytest.approx(impulse, abs=1e-13)
    R = Rotation.from_quat(many.quaternion[:, -1].values)
    assert (R * Rotation.from_rotvec(2 * impulse).inv()).magnitude() == pytest.approx(0, abs=1e-13)


def test_continuing():
    """The director scheme carries its director velocities on."""
    bodies, arguments = problem("suslov", "space", 3)
    stack, load = nt.DirectorSystem.stack(bodies), {key: arguments[key] for key in ("load", "load_scale")}
    scheme = {"step": 0.01, "integrator": "energy-momentum"}
    how = scheme | {"variables": "all"}
    half = nt.simulate_ensemble(stack, t_end=1, **arguments, **how)
    rest = nt.simulate_ensemble(stack, start=half, t_end=2, **load, **how)
    whole = nt.simulate_ensemble(stack, t_end=2, **arguments, **how)
    assert list(rest.time.values) == [1, 2]
    own = {"t_end": 2, "load": load["load_scale"][1] * load["load"], **scheme}
    one = nt.simulate(bodies[1], start=half.isel(member=1), **own)
    both = nt.simulate_ensemble(bodies[1], start=one.isel(time=slice(1)), load_scale=[0, 1], variables="all", **own)
    for found, expected in ((rest, whole), (one, whole.isel(member=1)), (both.isel(member=1), one)):
        for name in ("directors", "director_velocities"):
            last = expected[name].isel(time=-1).values
            assert found[name].isel(time=-1).values == pytest.approx(last, abs=1e-12)
    for start, words in ((half, "3 runs; continue one of them"), (half.isel(member=1, time=-1), "no dimension time")):
        with pytest.raises(ValueError, match=words):
            nt.simulate(bodies[1], start=start, **own)
    for name, words in (("quaternion", "; store it with"), ("director_velocities", ", which energy-momentum carries")):
        with pytest.raises(ValueError, match=f"start= lacks {name}{words}"):
            nt.simulate_ensemble(stack, start=half.drop_vars(name), t_end=2, **scheme)
    renamed = half.drop_vars("director_velocities").rename(member="other")
    with pytest.raises(ValueError, match="has the dimension other, and not member"):
        nt.simulate_ensemble(stack, start=renamed, t_end=2)


def test_an_ensemble_as_a_file(tmp_path):
    bodies, arguments = problem("nontwisting", "body", 3)
    many = nt.simulate_ensemble(nt.DirectorSystem.stack(bodies), **arguments, t_end=0.1, step=0.01, reduce=STATISTICS)
    nt.save_run(many, tmp_path / "many.nc")
    again = nt.open_run(tmp_path / "many.nc")
    xarray.testing.assert_identical(again, many)
    E = nt.SystemStack(again.euler_inertia.values, again.constrained_axis.values)
    assert [E[i].convected_inertia.tolist() for i in range(3)] == [body.convected_inertia.tolist() for body in bodies]


def test_members_are_runs():
    """A member has its own body and its own load, in what is computed and told of it; many are no motion of one."""
    bodies = [nt.suslov([[3, 0.1, 0], [0.1, 4, 0.2], [0, 0.2, 5]], axis) for axis in ("y", (0, 1, 1))]
    load, W = nt.spring(2.0, (0, 0, 1), (1, 0, 1)) + nt.pulse((0, 1, 2)), {"material_angular_velocity": (0.4, 0, 0)}
    how = {"t_end": 1, "step": 0.05, "store": 1}
    for many in (bodies, bodies[1]):
        own = nt.simulate_ensemble(many, load=load, load_scale=[1, 2], variables="all", **W, **how)
        member, run = own.isel(member=1), nt.simulate(bodies[1], load=2 * load, **W, **how)
        joined = nt.join_runs(member.isel(time=slice(9)), member.isel(time=slice(8, None)))
        for one in (member, joined, nt.resample(member, member.time)):
            assert np.allclose(nt.resample(one, [0.33]).directors, nt.resample(run, [0.33]).directors, atol=1e-12)
            assert content(one)["about"]["Load"] == content(run)["about"]["Load"]
            assert abs(nt.plot.twist_angle(one).lines[0].get_ydata()).max() < 1e-6
        nt.plot.polhode(member)
        assert nt.drifts(member).keys() == nt.drifts(run).keys() - {"energy_balance"}
    for function in (
        lambda: nt.simulate(bodies[0], rotation=own, t_end=1),
        lambda: nt.stepper(bodies[0], 0.1).reset(rotation=own),
        lambda: nt.steer(own, np.eye(3)),
        lambda: nt.simulate(bodies[0], rotation=member.isel(time=[]), t_end=1),
        lambda: nt.twist(own.isel(time=-1)),
        lambda: nt.simulate(bodies[0], start=run.drop_vars("time"), t_end=99),
        lambda: nt.resample(run.where(run.time < 0.5), [0.1]),
        lambda: nt.drifts(run.isel(time=[])),
        lambda: nt.sensors.gyroscope(run.isel(time=[]), rate=9),
        lambda: second_quotient(*3 * [run.isel(time=0)]),
    ):
        with says():
            function()


def test_torques_of_members():
    """They are in the load of a part that is joined, as in that of a run."""
    turning = nt.wheel((0, 0, 1), 0.1, speed=2)
    how = {"t_end": 1, "step": 0.05, "store": 1, "material_angular_velocity": (0.4, 1, 0)}
    many = nt.simulate_ensemble(STANDARD, load=turning, wheel_torque=[[0.1], [0.2]], variables="all", **how)
    run = nt.simulate(STANDARD, load=nt.wheel((0, 0, 1), 0.1, speed=2, torque=0.2), **how)
    member = many.isel(member=1)
    joined = nt.join_runs(member.isel(time=slice(9)), member.isel(time=slice(8, None)))
    assert np.allclose(nt.resample(joined, [0.33]).wheel_speed, nt.resample(run, [0.33]).wheel_speed, atol=1e-12)


def test_progress_reaches_the_end(capsys, monkeypatch):
    how, seen = {"t_end": 0.1, "step": 0.01, "angular_velocity": np.ones((40, 3)), "progress": True}, []
    nt.simulate_ensemble(nt.standard(PAPER_J), **how)
    assert "members" in capsys.readouterr().err
    for module in ("ensembles", "single_run"):
        monkeypatch.setattr(f"nontwist.driver.{module}.progress_bar", lambda *_: nullcontext(seen.append))
    monkeypatch.setattr("nontwist.integrators.stack_march.NODES", 2)
    nt.simulate_ensemble(nt.standard(PAPER_J), **how, integrator="lie-midpoint")
    assert seen == pytest.approx(np.cumsum([16, 16, 8] * 5) / (40 * 5))
    for scheme, count in (("lie-midpoint", 5), (ReferenceEnergyMomentum(), 10)):
        seen.clear()
        nt.integrate(nt.standard(PAPER_J), **how | {"angular_velocity": (1, 1, 1)}, integrator=scheme, store="end")
        assert seen == pytest.approx(np.arange(1, count + 1) / count)


def test_continued_with_another_inertia():
    """The momentum jumps; that of the same inertia, held or released, goes on without a word."""
    J, how = np.array([2.0, 4, 5]), {"step": 0.1, "material_angular_velocity": (1, 0, 0)}
    many = nt.simulate_ensemble
    for first, function in ((nt.integrate, nt.simulate), (many, many)):
        run = first(nt.standard(J), t_end=1, **how)
        with warned("start-other-inertia") as told:
            function(nt.nontwisting(J + 0.5), t_end=2, step=0.1, start=run)
        assert told[0].fields["most"] == pytest.approx(0.5)
        with warned():
            function(nt.nontwisting(J), t_end=2, step=0.1, start=run)


@pytest.mark.parametrize(
    ("how", "times"), [({"step": 0.05, "integrator": "lie-midpoint"}, 3.1), ({"step": 0.05}, 4.6), ({}, 8.1)], ids=str
)
def test_memory_of_results(how, times):
    """Beside it there are what members carry from step to step, and those of several runs to a tolerance."""
    how = {"t_end": 0.1, "threads": 1} | how
    W = np.random.default_rng(0).normal(size=(10_000, 3))
    nt.simulate_ensemble(nt.standard(PAPER_J), material_angular_velocity=W[:100], **how)
    tracemalloc.start()
    try:
        many = nt.simulate_ensemble(nt.standard(PAPER_J), material_angular_velocity=W, **how)
        kept, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 1.02 * many.nbytes
    assert most < times * many.nbytes


def test_labelled_velocities():
    W = np.arange(9.0).reshape(3, 3)
    labelled = xarray.DataArray(W.T[::-1], dims=("director", "member"), coords={"director": [3, 2, 1]})
    many = nt.simulate_ensemble(STANDARD, t_end=1, step=0.1, material_angular_velocity=labelled)
    assert (many.material_angular_velocity.values[:, 0] == W).all()


def test_labels_of_pandas():
    """Letters of axes are put in order; numbers count rows, in whatever order these are."""
    pandas, W = pytest.importorskip("pandas"), np.arange(9.0).reshape(3, 3)
    table = pandas.DataFrame(W, index=[2, 0, 1], columns=list("xyz"))
    for given in (table, table[["z", "x", "y"]]):
        many = nt.simulate_ensemble(STANDARD, t_end=1, step=0.1, material_angular_velocity=given)
        assert (many.material_angular_velocity.values[:, 0] == W).all()
    J = pandas.DataFrame(PAPER_J, list("xyz"), list("xyz"))
    assert (nt.standard(J.loc[list("yzx"), list("zxy")]).inertia == nt.standard(PAPER_J).inertia).all()
    run = nt.simulate(STANDARD, t_end=1, step=0.1, angular_velocity=table.loc[0, ["y", "z", "x"]])
    assert run.angular_velocity.values[0] == pytest.approx(W[1])


@pytest.mark.filterwarnings("ignore:the step is coarse", "ignore:.* have failed")
def test_extrema_beside_failed_members():
    how = {"t_end": 5, "step": 0.5, "reduce": "extrema"}
    many = nt.simulate_ensemble(nt.standard([3, 4, 5]), material_angular_velocity=[[0.1, 2, 0.1], [0, 900, 3]], **how)
    assert list(many.status) == [0, 3]
    assert many.kinetic_energy_max.values == pytest.approx([8.04, np.nan], rel=1e-12, nan_ok=True)
