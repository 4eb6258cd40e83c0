"""Sweeps: members are functions of file and number, and a store holds each of them once, whatever happens to it."""

import json
import os
import re
import warnings
from itertools import count, pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray
from matplotlib.collections import QuadMesh
from pydantic import ValidationError
from scipy import stats
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import ended, nontwist, problems_of
from nontwist import Problem, exact, heavy_top, open_sweep, simulate, standard, suslov, sweep, sweep_member, wheel
from nontwist.driver.notices import duration
from nontwist.errors import RunFileError, Status, SweepError, SweepStoreError
from nontwist.io.whole import locked
from nontwist.runfile import read_run_file
from nontwist.runfile.body import Body
from nontwist.runfile.section import problems_of as faults_of
from nontwist.runfile.sweep_table import KINDS, Sweep
from nontwist.sweeps.members import InvalidMembersError, Members, stack, values
from nontwist.sweeps.opening import draw
from nontwist.sweeps.store import ABSENT, SweepStore, open_store
from nontwist.sweeps.sweeping import LARGEST, LONGEST, MOST, _block, plan
from refusals import said, says

INERTIA = [[3.0, 0.2, 0.1], [0.2, 4.0, -0.3], [0.1, -0.3, 5.0]]
FREE = f"""
body = {{ kind = "standard", inertia = {INERTIA} }}
start.angular_velocity.body = [6.0, -18.0, 1.0]
time.t_end = 0.5
time.step = 0.025
integrator.order = 8
[sweep]
samples = 50
seed = 7
over = [
    {{ key = "start.rotation", kind = "rotation" }},
    {{ key = "start.angular_velocity.body", kind = "sphere", radius = 3.0 }},
]
"""
HELD = """
body = { kind = "suslov", inertia = [[3.0, 0.2, 0.4], [0.2, 4.0, -0.3], [0.4, -0.3, 5.0]], axis = [0.1, 0.2, 1.0] }
start = { angular_velocity = { body = [1.0, -2.0, 1.0] }, project = true }
load = [{ kind = "pulse", frame = "body", amplitude = [1.0, 2.0, 0.0], end = 0.5 }]
time.t_end = 1.0
time.step = 0.125
[sweep]
[[sweep.over]]
key = "body.axis.0"
kind = "grid"
start = -1.0
end = 1.0
count = 5
"""


def a_list(key, values):
    return f'[[sweep.over]]\nkey = "{key}"\nkind = "list"\nvalues = {values}\n'


def table(**changes):
    over = changes.pop("over", [{"key": "a", "kind": "uniform", "low": 0, "high": 1}])
    return Sweep.model_validate({"over": over, **changes})


EVERY_KIND = [
    {"key": "g", "kind": "grid", "start": 1, "end": 100, "count": 3, "spacing": "log"},
    {"key": "l", "kind": "list", "values": [[1, 2], [3, 4]]},
    {"key": "u", "kind": "uniform", "low": [0, -1, 5], "high": [1, 1, 5]},
    {"key": "n", "kind": "normal", "mean": 2, "deviation": 3},
    {"key": "s", "kind": "sphere", "radius": 2},
    {"key": "r", "kind": "rotation"},
]


@pytest.mark.parametrize("sampling", ["random", "sobol", "halton"])
def test_member_by_file_and_number(sampling):
    one = table(over=EVERY_KIND, samples=211, sampling=sampling, seed=3)
    whole = values(one, 0, one.members)
    assert one.members == 3 * 2 * 211
    for first, last in ((0, 1), (1, 2), (210, 213), (700, 1266), (5, 6), (1265, 1266)):
        for key, block in values(one, first, last).items():
            assert block.tobytes() == whole[key][first:last].tobytes(), (key, first)


def test_product_of_grids_and_lists():
    found = values(table(over=EVERY_KIND[:2]), 0, 6)
    np.testing.assert_allclose(found["g"], [1, 1, 10, 10, 100, 100], rtol=1e-15)
    assert found["l"].tolist() == [[1, 2], [3, 4]] * 3
    pairs = [EVERY_KIND[0], {"key": "l", "kind": "list", "values": [7, 8, 9]}]
    together = values(table(over=[*pairs, EVERY_KIND[3]], combine="together", samples=2), 0, 6)
    np.testing.assert_allclose(together["g"], [1, 1, 10, 10, 100, 100], rtol=1e-15)
    assert together["l"].tolist() == [7, 7, 8, 8, 9, 9]


def test_table_without_a_kind():
    """And no other kind; one that is none is refused with all."""
    assert table(over=[{"key": "l", "values": [1, 2]}]) == table(over=[{"key": "l", "kind": "list", "values": [1, 2]}])
    with pytest.raises(ValidationError) as told:
        table(over=[{"key": "u", "low": 0}, {"key": "l", "kind": 3, "values": [1]}])
    faults = {one.key: one.accepted for one in faults_of(told.value)}
    assert faults.keys() == {"over.0.low", "over.0.values", "over.1.kind"}
    assert 'kind = "uniform"' in faults["over.0.low"]
    assert all(f'"{kind}"' in faults["over.1.kind"] for kind in KINDS)
    validator = pytest.importorskip("jsonschema").Draft202012Validator(Sweep.model_json_schema())
    assert validator.is_valid({"over": [{"key": "l", "values": [1, 2]}]})
    assert not validator.is_valid({"over": [{"key": "u", "low": 0, "high": 1}]})


def test_draws_are_independent():
    alone, among = table(over=EVERY_KIND[3:4], seed=5), table(over=EVERY_KIND, seed=5)
    assert values(alone, 0, 1)["n"].tobytes() == values(among, 0, 1)["n"].tobytes()
    assert values(table(over=EVERY_KIND[3:4], seed=6), 0, 1)["n"] != values(alone, 0, 1)["n"]
    part = values(table(over=[{"key": "n", "kind": "uniform", "low": 0, "high": 1}], seed=5), 0, 1)["n"]
    assert values(alone, 0, 1)["n"] == pytest.approx(stats.norm(2, 3).ppf(part))


@pytest.mark.parametrize("sampling", ["random", "sobol", "halton"])
def test_distributions(sampling):
    m = 4096
    found = values(table(over=EVERY_KIND[2:], samples=m, sampling=sampling, seed=1), 0, m)
    turn = Rotation.from_quat(found["r"])
    angle, image = turn.magnitude(), turn.apply([0.6, 0.0, 0.8])
    samples = {
        "uniform": (found["u"][:, 1], stats.uniform(-1, 2).cdf),
        "normal": (found["n"], stats.norm(2, 3).cdf),
        "angle of rotations": (angle, lambda t: (t - np.sin(t)) / np.pi),  # Haar's measure
        "longitude": (np.arctan2(found["s"][:, 1], found["s"][:, 0]), stats.uniform(-np.pi, 2 * np.pi).cdf),
        **{f"direction {k}": (found["s"][:, k] / 2, stats.uniform(-1, 2).cdf) for k in range(3)},  # Archimedes
        **{f"image {k}": (image[:, k], stats.uniform(-1, 2).cdf) for k in range(3)},
    }
    for name, (sample, cdf) in samples.items():
        assert stats.kstest(sample, cdf).pvalue > 1e-3, name
    assert (found["u"][:, 2] == 5).all()
    np.testing.assert_allclose(np.linalg.norm(found["s"], axis=1), 2, rtol=1e-15)
    gap = stats.kstest(found["u"][:, 0], stats.uniform.cdf).statistic
    assert gap > 3e-3 if sampling == "random" else gap < 2e-3  # of 4096 points: random 1/64, even 1/4096


def test_bodies_at_once():
    held = Body(kind="suslov", inertia=INERTIA, axis=[0.1, 0.2, 1.0])
    axes, J11 = np.random.default_rng(0).normal(size=(9, 3)), np.linspace(2.5, 3.5, 9)
    axes[5:] /= np.linalg.norm(axes[5:], axis=1)[:, None]
    made = stack(held, {"axis": axes, "inertia.0.0": J11}, Path())
    for i, axis in enumerate(axes):
        one = suslov(INERTIA + np.diag([J11[i] - 3.0, 0, 0]), axis)
        np.testing.assert_allclose(made.euler_inertia[i], one.euler_inertia, atol=1e-15)
        assert made.axis[i].tobytes() == one.axis.tobytes()
    flat = Body(kind="nontwisting", inertia=[3.0, 4.0, 5.0])
    made = stack(flat, {"inertia": np.array([[1.0, 2, 2.5], [2, 2, 4]])}, Path())
    np.testing.assert_allclose(made.euler_inertia[1], nt.nontwisting([2, 2, 4]).euler_inertia, atol=1e-15)
    block = np.array([np.diag([3.0, 4, 5])] * 2)
    block[1, 0, 2] = block[1, 2, 0] = 0.5
    heavy = Body(kind="heavy_top", inertia=[2.0, 2.0, 1.0], mass=1.0, centre_of_mass=[0.0, 0, 0.5])
    for body, key, given, reasons in (
        (flat, "inertia.2", [5.0, 8.0, 6.0, -1.0], {1: "body.physical = false accepts them", 3: ""}),
        (Body(kind="nontwisting", inertia=block[0].tolist()), "inertia", block, {1: "D3 is not a principal direction"}),
        (held, "axis", [[1.0, 2, 3], [0, 0, 0]], {1: "axis is zero"}),
        (heavy, "mass", [1.0, -1.0, 1e3], {1: "body.mass: -1.0 -> a positive number, kg", 2: "inertia is too small"}),
    ):
        with pytest.raises(InvalidMembersError) as caught:
            stack(body, {key: np.array(given)}, Path())
        assert [*caught.value.reasons] == [*reasons]
        assert all(words in caught.value.reasons[i] for i, words in reasons.items())


def test_closed_solution(write, tmp_path):
    many = sweep(write(FREE), tmp_path / "free.zarr", workers=2, block=16)
    assert many.sizes["member"] == 50
    assert (many.status == 0).all()
    for i in (0, 17, 49):
        W, start = many["start.angular_velocity.body"][i].values, Rotation.from_quat(many["start.rotation"][i].values)
        R, end = exact.free_standard(INERTIA, W, [0.5], rotation=start)
        np.testing.assert_allclose(Rotation.from_quat(many.quaternion[i].values).as_matrix(), R[0], atol=1e-10)
        np.testing.assert_allclose(many.material_angular_velocity[i], end[0], atol=1e-10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for consolidated in (None, True, False):
            with xarray.open_zarr(tmp_path / "free.zarr", consolidated=consolidated) as plain:
                assert (plain.quaternion == many.quaternion).all()


def turned(frame, rotation, key="body.inertia.0"):
    """A sweep whose members start turned: a quaternion that is scaled to length 1 twice may change."""
    start = f'rotation = {{ {rotation} }}, angular_velocity = {{ {frame} = [0, 3, 573], unit = "rpm" }}'
    return f"""
body = {{ kind = "standard", inertia = [0.1, 0.11, 0.02] }}
start = {{ {start} }}
time = {{ t_end = 0.5, step = 0.01 }}
sweep.over = [{{ key = "{key}", kind = "grid", start = 0.1, end = 0.12, count = 5 }}]
"""


def test_hash_is_independent_of_blocks(write, tmp_path):
    hashes, longer = [], FREE.replace("t_end = ", "t_end = 1")
    runs = [(FREE, 7, 2), (FREE, 50, 1), (longer, None, 1), (LOADED, 11, 1), (LOADED, 50, 1)]
    for k, (text, block, workers) in enumerate(runs):
        sweep(write(text), tmp_path / f"{k}.zarr", workers=workers, block=block)
        hashes.append(open_store(tmp_path / f"{k}.zarr").verified().sha256)
    assert hashes[0] == hashes[1] != hashes[2]
    assert hashes[3] == hashes[4]
    assert None not in hashes


LOADED = FREE.replace(
    "[sweep]",
    """load = [
    { kind = "dipole", moment = [0.3, 0.7, 1.1], field = [1.3, 0.1, -0.7] },
    { kind = "wheel", axis = [0.3, 0.7, 1.1], inertia = 0.3, speed = 7.7, torque = 0.1 },
]
[sweep]
variables = ["potential_energy", "wheel_speed", "wheel_work", "total_momentum"]""",
)
ORBIT = 'load = [{ kind = "gravity_gradient", mean_motion = 5.0 }]\n[sweep]\nvariables = ["potential_energy"]'


AGAIN = [
    *(FREE, HELD, FREE.replace("[sweep]", ORBIT)),
    turned("space", 'euler = [20.0, 35.0, 70.0], sequence = "ZYX", unit = "degrees"', "start.rotation.euler.0"),
    turned("body", 'vector = [0.35, 0.2, 0.1], unit = "radians"', "start.rotation.vector.1"),
    turned("space", 'euler = [20.0, 35.0, 70.0], sequence = "ZYX", unit = "degrees"'),
    turned("body", "matrix = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]"),
]


@pytest.mark.parametrize("text", [*AGAIN[:5], *(pytest.param(text, marks=pytest.mark.long) for text in AGAIN[5:])])
def test_member_runs_again(text, write, tmp_path):
    """Whether its attitude is fixed or swept."""
    store = tmp_path / "store"
    many = sweep(write(text), store, workers=1)
    for i in (0, 4):
        run = sweep_member(store, i)
        for name in {"quaternion", "material_angular_velocity", "potential_energy"} & {*many}:
            assert run[name][-1].values.tobytes() == many[name][i].values.tobytes()
        assert np.sum(run.quaternion.values[1:] * run.quaternion.values[:-1], axis=1) == pytest.approx(1, abs=0.1)
        alone = simulate(read_run_file(write(run.attrs["run_file"], "member.toml")).problem)
        np.testing.assert_allclose(run.directors, alone.directors, atol=1e-12)
    nt.save_run(run, tmp_path / "member.nc")
    body = nt.DirectorSystem.from_json(run.attrs["system"])
    two = nt.simulate_ensemble(body, start=run, t_end=run.time.values[-1] + 0.01, step=1e-3, load_scale=[1, 1])
    assert two.quaternion[1, 0].values == pytest.approx(run.quaternion[-1].values, abs=1e-15)
    count = many.sizes["member"]
    with pytest.raises(ValueError, match=rf"^member must be at most {count - 1}, got {count}$"):
        sweep_member(store, count)


def test_keys_of_any_kind(write, tmp_path):
    """Those that are axes of an ensemble, as a scale of the load, and those that are none."""
    swept = {"load.0.amplitude": [[0, 0, 0], [1, 2, 0]], "integrator.order": [2, 4], "time.t_end": [0.5, 1.0]}
    swept["load.0.scale"] = [-1.0, 0.5]
    over = "".join(a_list(key, values) for key, values in swept.items())
    text = HELD.replace("time.t_end", "integrator.order = 4\ntime.t_end") + over
    many = sweep(write(text), tmp_path / "store", block=20)
    assert many.status.values.tolist() == [0] * 80
    for i in (0, 27, 34, 79):
        given = {key: many[key][i].values.tolist() for key in swept}
        given["integrator.order"] = int(given["integrator.order"])
        file = read_run_file(write(HELD), [f"{key}={value}" for key, value in given.items()])
        body = suslov(file.problem.system.convected_inertia, [float(many["body.axis.0"][i]), 0.2, 1.0])
        run = simulate(Problem(body, **file.problem.given))
        np.testing.assert_allclose(run.material_angular_velocity[-1], many.material_angular_velocity[i], atol=1e-13)


def test_failing_members(write, tmp_path, capsys):
    text = HELD.replace("body.axis.0", "load.0.scale").replace("start = -1.0", "start = 0.0")
    text = text.replace("end = 1.0\ncount = 5", "end = 1e4\ncount = 101")
    many = sweep(write(text + a_list("body.inertia.2.2", [5, 9])), tmp_path / "store", block=101, progress=True)
    shown = capsys.readouterr().err.split()
    status = many.status.values.reshape(101, 2)
    assert (status[:, 1] == -1).all()  # 9 > 3 + 4
    assert status[0, 0] == 0
    assert set(status[60:, 0]) <= {Status.TURN, Status.STALLED}
    assert np.isnan(many.quaternion.values[many.status.values != 0]).all()
    assert np.isfinite(many.quaternion.values[many.status.values == 0]).all()
    facts = json.loads(nontwist("sweep-show", tmp_path / "store", "--json").stdout)
    assert facts["failed"] == int((many.status != 0).sum())
    assert shown[-5:] == ["0", "s", "left,", str(facts["failed"]), "failed"]
    assert facts["failures"][0]["members"] == 101
    assert "triangle inequality" in facts["failures"][0]["reason"]
    turned = next(one for one in facts["failures"] if "try step <=" in one["reason"])
    last = sweep_member(tmp_path / "store", turned["first"])
    assert last.attrs["message"] == turned["reason"]
    assert last.time[-1] < 1
    with pytest.raises(RunFileError, match="triangle inequality"):
        sweep_member(tmp_path / "store", 1)


def test_wrong_load_fails(tmp_path):
    spring = Problem(standard([1, 2, 2.5]), t_end=1, step=0.1, load=nt.spring(1.0, (0, 0, 1), (0, 0, 2)))
    many = sweep(spring, tmp_path / "store", over={"load.0.stiffness": [-1.0, 1.0]})
    assert many.status.values.tolist() == [-1, 0]
    with pytest.raises(RunFileError, match=r"load\.0\.stiffness: -1\.0 -> a positive number"):
        sweep_member(tmp_path / "store", 0)


def test_all_members_refused(write, tmp_path):
    text = HELD.replace("project = true", "project = false")
    with pytest.raises(RunFileError, match=r"spin|project"):
        sweep(write(text), tmp_path / "store")
    for old, new in (("[1.0, -2.0, 1.0]", "[0.0, 5.0, -1.0]"), ("axis.0", "axis.2"), ("start = -1.0", "start = 0.5")):
        text = text.replace(old, new)
    text = text.replace("end = 1.0\ncount", "end = 0.6\ncount")
    with pytest.raises(ValueError, match=r"^all 5 members tried are refused, the first because: the initial angular "):
        sweep(write(text), tmp_path / "store")
    assert [path.name for path in tmp_path.iterdir()] == ["run.toml"]


def test_interrupted_and_run_again(write, tmp_path, monkeypatch):
    file, done = write(FREE), 0
    sweep(file, tmp_path / "whole", block=5)
    for by, at in (("", 15), ("interrupted (SIGHUP)", 25)):

        def stop(now, by=by, at=at):
            if now.done == at:  # once: what is in hand is brought home, and told as well
                raise KeyboardInterrupt(by)

        words = rf"^{re.escape(by or 'interrupted')}; (\d+) of 10 blocks are done and kept in .*; run again"
        with pytest.raises(KeyboardInterrupt, match=words):
            sweep(file, tmp_path / "parts", block=5, workers=1, progress=stop)
        part = open_sweep(tmp_path / "parts")
        done = int((part.status == 0).sum())
        assert at < done < 50
        assert int((part.status == ABSENT).sum()) == 50 - done
        assert np.isnan(part.quaternion.values[part.status.values == ABSENT]).all()
    seen = []
    monkeypatch.setattr("nontwist.sweeps.sweeping.perf_counter", count().__next__)  # a second for each block
    sweep(file, tmp_path / "parts", workers=1, progress=seen.append)
    assert len(seen) == (50 - done) // 5
    assert [(now.rate, now.left) for now in seen] == [(5, (50 - now.done) / 5) for now in seen]
    assert seen[-1].done == 50
    whole, parts = (open_store(tmp_path / name).verified().sha256 for name in ("whole", "parts"))
    assert whole == parts is not None


def test_failing_blocks(write, tmp_path, monkeypatch):
    sound, calls = SweepStore.make, []

    def unlucky(self, k):
        calls.append(k)
        if k == 3 or (k == 1 and calls.count(1) < 3):
            raise RuntimeError("no luck")
        return sound(self, k)

    monkeypatch.setattr(SweepStore, "make", unlucky)
    with pytest.raises(SweepError) as caught:
        sweep(write(FREE), tmp_path / "store", block=10, workers=1)
    said(str(caught.value))
    assert caught.value.failed == {3: "RuntimeError: no luck"}
    assert (calls.count(3), calls.count(1)) == (3, 3)
    assert open_store(tmp_path / "store").verified().missing == (3,)
    monkeypatch.setattr(SweepStore, "make", sound)
    assert (sweep(write(FREE), tmp_path / "store").status == 0).all()


def test_many_failures(write, tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(SweepStore, "make", lambda self, k: calls.append(k) or 1 / 0)
    with pytest.raises(SweepError, match="ZeroDivisionError"):
        sweep(write(FREE), tmp_path / "store", block=1, workers=1)
    assert len(calls) < 20


def test_second_client_is_refused(write, tmp_path):
    file, store = write(FREE), tmp_path / "store"
    with locked(store, str(store)), pytest.raises(BlockingIOError, match="another process is writing"):
        sweep(file, store)
    sweep(file, store, block=25)
    (tmp_path / "folder").mkdir()
    other, none = write(FREE.replace("seed = 7", "seed = 8"), "o.toml"), write(FREE.split("[sweep]")[0], "none.toml")
    differs = r"is the store of another file: it was made with seed = 7, the file now"
    for one, place, how, error, words in (
        (other, "store", {}, SweepStoreError, differs),
        (file, "store", {"block": 10}, SweepStoreError, r"has blocks of 25 members, not of 10; leave block out"),
        (file, "folder", {}, SweepStoreError, "is not the store of a sweep"),
        (file, "no/store", {}, FileNotFoundError, "there is no folder"),
        (none, "none", {}, ValueError, r"no table \[sweep\]"),
    ):
        with pytest.raises(error, match=words):
            sweep(one, tmp_path / place, **how)


def test_bytes_of_a_member(write, tmp_path):
    text = FREE.replace("order = 8", 'name = "exact"').replace("time.step = 0.025\n", "").replace("= 50", "= 20000")
    store = tmp_path / "store"
    sweep(write(text), store)
    size = sum(path.stat().st_size for path in store.rglob("*") if path.is_file())
    assert 57 * 20000 < size < 60 * 20000


def test_size_of_blocks():
    for case in ((10**8, 1e-7, 57, 2), (10**6, 1e-3, 57, 1000), (10**4, 4.0, 57, 2), (10**8, 1e-6, 5000, 8)):
        block, (_, each, size, _) = _block(*case), case
        assert block == 1 or block * each <= LONGEST
        assert block * size <= LARGEST
        assert block <= MOST
        assert block * each > 0.1 or block * size > LARGEST / 2 or block > MOST / 2
    assert _block(50, 1e-3, 57, 2) == 50


def test_a_plan_leaves_compilation_out(write, monkeypatch):
    """Even where the first member is refused and nothing is compiled for it."""
    text = HELD.replace("start = -1.0", "start = 0.0").replace("[0.1, 0.2, 1.0]", "[0.1, 0.0, 0.0]")
    members, now, compiled = Members(read_run_file(write(text.replace("count = 5", "count = 2000")))), [0.0], []
    run = members.run

    def timed(numbers):
        results = run(numbers)
        if (results.status == 0).any() and not compiled:
            compiled.append(now.append(now.pop() + 47.0))
        now[0] += 1e-3 + 1e-5 * len(results.status)
        return results

    monkeypatch.setattr(members, "run", timed)
    monkeypatch.setattr("nontwist.sweeps.sweeping.perf_counter", lambda: now[0])
    coming = plan(members, 2)
    assert compiled
    assert (coming.blocks, coming.seconds_each) == (1, pytest.approx(1e-5, rel=0.1))
    assert coming.seconds == coming.members * coming.seconds_each


def test_plan_runs_slow_members_once(write, monkeypatch):
    members, now, tried = Members(read_run_file(write(HELD))), [0.0], []
    run = members.run

    def timed(numbers):
        results = run(numbers)
        tried.append(len(results.status))
        now[0] += 2.0 * tried[-1]
        return results

    monkeypatch.setattr(members, "run", timed)
    monkeypatch.setattr("nontwist.sweeps.sweeping.perf_counter", lambda: now[0])
    assert plan(members, 2).seconds_each == pytest.approx(2.0)
    assert tried == [2, len(members)]


def test_spans_of_time_in_words():
    spans = {0: "0 s", 3e-5: "30 µs", 0.42: "420 ms", 5.04: "5 s", 42.4: "42 s", 59.7: "1 min 0 s", 185: "3 min 5 s"}
    spans |= {7500: "2 h 5 min", 270000: "3 d 3 h"}
    assert {span: duration(span) for span in spans} == spans


OVER = '{ key = "body.axis.0", kind = "grid", start = 0, end = 1, count = 3 }'
WRONG = [
    'sweep.over.0.kind="spere"',
    "sweep.sampels=3",
    'sweep.over.0.key="body.axs"',
    'sweep.over.0.key="body.axis"',
    'sweep.over.0.key="start.rotation"',
    "sweep.over.0.count=0",
    'sweep.over.0.spacing="log"',
    "sweep.samples=2",
    f"sweep.over=[{OVER}, {OVER}]",
    f'sweep={{combine="together", over=[{OVER}, {{ key = "body.axis.1", kind = "list", values = [1, 2] }}]}}',
    'sweep.over=[{ key = "body.axis", kind = "list", values = [[1, 2, 3], [1]] }]',
    'sweep.over=[{ key = "body.axis", kind = "uniform", low = [0, 1, 2], high = [1, 0, 3] }]',
    'sweep.over=[{ key = "body.axis.0", kind = "uniform", low = -1, high = 1 }]',
]


@pytest.mark.parametrize("change", WRONG)
def test_table_errors(change, write):
    with says(RunFileError):
        read_run_file(write(HELD), [change])


def test_several_errors_at_once(write):
    stepless = HELD.replace("time.step = 0.125\n", "")
    spelt = stepless.replace('kind = "suslov"', 'kind = "suslow"').replace("count = 5", "count = -5")
    kept = stepless.replace("[[sweep.over]]", 'variables = ["spin"]\n[[sweep.over]]', 1)
    misspelt = HELD.replace("body.axis.0", "body.axs.0")
    event, orbit = '[[event]]\nkind = "spin-below"\nvalue = 0.1\n', ORBIT.partition("\n")[0].replace(" = ", "=", 1)
    reduced, unlike = 'sweep.reduce=["drift"]', '{ kind = "wheel", axis = [1, 0], inertia = 0.1 }'
    for text, keys, *changes in (
        (misspelt.replace("[[sweep", 'reduce = ["drfit"]\n[[sweep', 1), ["sweep.reduce.0", "sweep.over.0.key"]),
        (misspelt + a_list("body.axis.1", []), ["sweep.over.1.values", "sweep.over.0.key"]),
        (spelt, ["body.kind", "sweep.over.0.count", "time.step"]),
        (kept, ["sweep.variables.0", "time.step"]),
        (FREE, ["sweep.reduce"], reduced, 'integrator={name="exact"}'),
        (FREE, ["sweep.reduce"], reduced, orbit),
        (FREE, ["load.0.axis"], 'sweep.variables=["wheel_speed"]', f"load=[{unlike}]"),
    ):
        assert [told.partition(": ")[0] for told in problems_of(write(text), *changes)] == keys
    with pytest.raises(RunFileError, match=r"\[sweep\]: event: 2 tables -> left out"):
        Members(read_run_file(write(HELD + event + event)))
    with pytest.raises(RunFileError, match=r"time\.step: missing -> a step, s, which all members take; ") as caught:
        read_run_file(write(stepless))
    step, order = re.search(r"take; (\S+) with integrator\.order = (\d+) suits the file", str(caught.value)).groups()
    read_run_file(write(stepless), [f"time.step={step}", f"integrator.order={order}"])


def test_file_is_read_again(write):
    for text in (FREE, HELD):
        first = read_run_file(write(text))
        assert read_run_file(write(first.text(), "again.toml")).text() == first.text()
        assert "sweep" not in first.record()["run_file"]


@pytest.mark.usefixtures("here")
def test_the_commands(write):
    write(HELD + a_list("body.axis.1", [0.1]), "sweep.toml")
    assert "list: 1 value " in nontwist("sweep", "sweep.toml", "--dry-run").stdout
    write(HELD + a_list("body.axis.1", [0.1, 0.2]), "sweep.toml")
    dry = nontwist("sweep", "sweep.toml", "--dry-run")
    for words in ("grid: start -1.0, end 1.0, count 5", "list: 2 values", "570 B", "57 bytes per member", "10 members"):
        assert words in dry.stdout
    assert re.search(r"about \S+ .?s on \d+ cores like this one, without start-up \(\S+ .?s per member", dry.stdout)
    assert dry.stderr == "next: nontwist sweep sweep.toml --out sweep.zarr\n"
    options = ["--set", "time.step=0.25", "--set", "integrator.order=4", "--block", "2", "--workers", "1"]
    dry = nontwist("sweep", "sweep.toml", *options, "--dry-run", "--out", "a b.zarr")
    again = "--out 'a b.zarr' --workers 1 --block 2 --set time.step=0.25 --set integrator.order=4"
    assert dry.stderr == f"next: nontwist sweep sweep.toml {again}\n"
    assert os.listdir() == ["sweep.toml"]
    ran = nontwist("sweep", "sweep.toml", "--workers", "1")
    assert ran.stderr == "written: sweep.zarr; next: nontwist sweep-show sweep.zarr\n"
    assert "10, 0 failed" in ran.stdout
    write(HELD.replace("[1.0, -2.0, 1.0]", "[1e3, 0.0, 0.0]").replace("step = 0.125", "step = 1.0"), "coarse.toml")
    assert "5 of 5 members failed; nontwist sweep-show coarse.zarr" in nontwist("sweep", "coarse.toml").stderr
    shown = nontwist("sweep-show", "sweep.zarr")
    plotted = "--plot body.axis.0 body.axis.1 material_angular_velocity"
    assert shown.stderr == f"next: nontwist sweep-show sweep.zarr {plotted}\n"
    for words in ("10 of 10 are done, 0 failed", " s of work", "over body.axis.0", "velocity at t_end", "quaternion"):
        assert words in shown.stdout
    assert "per point" not in shown.stdout  # nothing is drawn
    assert "reason of the first" not in shown.stdout
    assert "│ 5       │ 0     │ " in nontwist("sweep-show", "coarse.zarr").stdout  # and the reason
    verified = ended(0, "sweep-verify", "sweep.zarr").stdout
    assert "sweep.zarr is complete" in verified
    assert re.search("(.+) of \\1 are as they were written", verified)
    header, *lines = (line.split(",") for line in nontwist("export", "sweep.zarr").stdout.splitlines())
    members, table = open_sweep("sweep.zarr"), dict(zip(header, np.array(lines, dtype=float).T, strict=True))
    assert header[:4] == ["member", "body.axis.0", "body.axis.1", "quaternion_x"]
    assert table["body.axis.1"].tolist() == members["body.axis.1"].values.tolist() == [0.1, 0.2] * 5
    assert np.array_equal(table["quaternion_x"], members.quaternion[:, 0])
    chosen = nontwist("export", "sweep.zarr", "--columns", "status").stdout.splitlines()
    assert chosen == ["member,status", *(f"{k},0" for k in range(10))]
    again = ended(0, "sweep-show", "sweep.zarr", "--member", "3", "--out", "3.nc")
    assert again.stderr == "written: 3.nc; next: nontwist view 3.nc\n"
    assert "member 3 of" in nontwist("info", "3.nc").stdout
    ended(0, "sweep-show", "sweep.zarr", "--member", "3", "--out", "3.toml")
    assert read_run_file("3.toml").body.axis == [0.0 - 0.5, 0.2, 1.0]
    for line, code in (
        ("sweep-show sweep.zarr quaternion", 2),
        ("sweep-show sweep.zarr --member 99", 3),
        ("sweep-show sweep.zarr --plot body.axis.2 quaternion", 3),
        ("sweep-show sweep.zarr --plot body.axis.0 quaternion.4", 3),
        ("sweep-show none.zarr", 5),
        ("sweep-verify sweep.toml", 3),
    ):
        said(ended(code, *line.split()).stderr.rpartition("Error: ")[2])
    ended(0, "precision", "sweep.toml")
    told, hint = nontwist("precision", "sweep.toml", "--target", "1e-3").stderr.splitlines()
    said(told)  # members take one step, and the hint is right as it stands
    assert hint == "next: nontwist sweep sweep.toml --set time.step=0.25 --set integrator.order=8"
    ended(0, *hint.split()[2:], "--dry-run")
    for given in ([], ["--set", "time.tolerance=1e-6", "--force"]):
        ran = nontwist("run", "sweep.toml", *given)
        assert "the table [sweep] is ignored; nontwist sweep sweep.toml runs" in ran.stderr
    assert "tolerance" in ran.stdout
    assert "10 members over body.axis.0, body.axis.1" in nontwist("check", "sweep.toml").stdout


PROPOSED = {
    "kinetic_energy": ["directors", "spatial_momentum", "kinetic_energy"],
    "spatial_momentum": ["quaternion", "directors", "spatial_momentum"],
    "quaternion.3": ["quaternion"],
    "directors.2.2": ["quaternion", "directors"],
}


@pytest.mark.usefixtures("here", "undrawn")
def test_proposed_figure(write):
    for name, variables in PROPOSED.items():
        text = HELD.replace("[sweep]", f"[sweep]\nvariables = {json.dumps(variables)}")
        sweep(write(text), f"{name}.zarr", workers=1)
        shown, line = nontwist("sweep-show", f"{name}.zarr"), f"sweep-show {name}.zarr --plot body.axis.0 {name}"
        assert shown.stderr == f"next: nontwist {line}\n"
    assert ended(0, *line.split()).stderr == f"written: {name}-{name}.png\n"
    matrix = "is a matrix, 3 × 3, which has no length; name one of its components, as in directors.2.2\n"
    refused = ended(3, "sweep-show", f"{name}.zarr", "--plot", "body.axis.0", "directors")
    assert refused.stderr == f"directors {matrix}"
    labels = {"directors.2": "directors_3 |$d_{3}$|", "directors.2.0": "directors_3_x $d_{3x}$"}
    assert {key: draw(f"{name}.zarr", ["body.axis.0"], key).get_ylabel() for key in labels} == labels


@pytest.mark.usefixtures("here", "undrawn")
def test_proposed_variable(write):
    over = {"body.inertia": [np.diag([3, 4, J]) for J in (5, 6)], "start.angular_velocity.body": [[0, 0, 1], [0, 0, 2]]}
    path = write(FREE + '[[load]]\nkind = "wheel"\naxis = "z"\ninertia = 0.1\nspeed = -100\n')
    sweep(path, "w.zarr", over=over, combine="together", variables=["wheel_speed"], workers=1)
    line = "sweep-show w.zarr --plot body.inertia.2.2 start.angular_velocity.body.2 wheel_speed"
    assert nontwist("sweep-show", "w.zarr").stderr == f"next: nontwist {line}\n"
    ended(0, *line.split())
    ax = draw("w.zarr", ["start.angular_velocity.body"], "wheel_speed")
    assert ax.get_xlabel().startswith("|start.angular_velocity.body| (rad")
    assert (ax.collections[0].get_offsets()[:, 1] < -90).all()


def test_logarithmic_axes(write, tmp_path):
    """Cells end half way between the values, on the scale of the axis."""
    free = FREE[: FREE.index("samples")] + 'variables = ["kinetic_energy"]\n'
    over = '{ key = "load.0.coefficient", kind = "grid", start = 0.01, end = 10, count = 4, spacing = "log" }'
    listed = '{ key = "load.0.scale", kind = "list", values = [4, 1, 2] }'
    text = f'{free}reduce = ["drift"]\nover = [{listed}, {over}]\n[[load]]\nkind = "damping"\ncoefficient = 1\n'
    many, store = sweep(write(text), tmp_path / "store", workers=1), tmp_path / "store"
    ax = draw(store, ["load.0.coefficient"], "energy_drift")
    assert (ax.get_xscale(), ax.get_ylabel()) == ("log", "energy drift (J)")
    ax = draw(store, ["load.0.coefficient", "load.0.scale"], "kinetic_energy")
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    (mesh,) = [one for one in ax.collections if isinstance(one, QuadMesh)]
    borders = np.asarray(mesh.get_coordinates())
    assert borders[0, :, 0] == pytest.approx(10.0 ** np.arange(-2.5, 2), rel=1e-12)
    assert borders[:, 0, 1] == pytest.approx([0.5, 1.5, 3, 5], rel=1e-12)
    columns = (many[name].values for name in ("load.0.scale", "load.0.coefficient", "kinetic_energy"))
    expected = [K for _, _, K in sorted(zip(*columns, strict=True))]
    assert np.ravel(mesh.get_array()).tolist() == expected


@pytest.mark.parametrize("deviation", [4e-4, *(pytest.param(one, marks=pytest.mark.long) for one in (2e4, 3e-7, 0.1))])
def test_labels_do_not_touch(deviation, write, tmp_path):
    """Components are called as in the exported table; ticks are measured in the file that is written."""
    keys = ["start.angular_velocity.space.0", "start.angular_velocity.space.2"]
    over = ", ".join(f'{{ key = "{key}", kind = "normal", mean = 0.0, deviation = {deviation} }}' for key in keys)
    start = "start.angular_velocity.space = [0, 2, 0]\ntime = { t_end = 1e-4, step = 1e-5 }\n"
    text = f'body = {{ kind = "standard", inertia = [3, 4, 5] }}\n{start}[sweep]\nsamples = 20\nseed = 1\n'
    sweep(write(f"{text}over = [{over}]\n"), tmp_path / "mc.zarr", workers=1)
    header = nontwist("export", str(tmp_path / "mc.zarr")).stdout.partition("\n")[0].split(",")
    for chosen in (keys[:1], keys):
        ax = draw(tmp_path / "mc.zarr", chosen, "quaternion.2")
        nt.plot.save(ax, tmp_path / f"{len(chosen)}.png")
        labels = [ax.get_xlabel(), ax.get_ylabel() if len(chosen) == 1 else ax.figure.axes[1].get_ylabel()]
        assert labels == ["start.angular_velocity.space.0 (rad s$^{-1}$)", "quaternion_z $p_{z}$"]
        assert all(any(column.split(" ")[0] == label.split(" ")[0] for column in header) for label in labels)
        ax.figure.draw_without_rendering()
        low, high = ax.get_xlim()
        ticks = [tick for tick in ax.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
        boxes = [tick.label1.get_window_extent() for tick in ticks]
        assert len(boxes) >= 2
        assert all(left.x1 + 2 < right.x0 for left, right in pairwise(boxes))


def test_example_closed_form(here):
    said(nontwist("example", "sweep").stderr)
    ended(0, "sweep", "sweep.toml", "--set", "sweep.samples=64", "--quiet")
    many = open_sweep("sweep.zarr").compute()
    assert (many.sizes["member"], int(many.status.sum())) == (64, 0)
    assert many.energy_drift.max() < 1e-14
    J, start = np.diag([2.0, 2.5, 3.0]), np.array([1.0, 0.6, -0.4])
    for axis, W in zip(many["body.axis"].values, many.material_angular_velocity.values, strict=True):
        ends = exact.suslov_velocity(J, axis, start - axis * (axis @ start), [200.0])[0]
        assert np.abs(W - ends).max() < 2e-5


def test_two_wheel_torques(tmp_path):
    """Members are runs of their own, and both wheels take the body's momentum with them: |π| is that of the start."""

    def wheels(one, other):
        return wheel((1, 0, 0), 0.2, speed=3, torque=one) + wheel((0, 0.6, 0.8), 0.2, speed=3, torque=other)

    problem = Problem(standard([3, 4, 5]), t_end=2, step=0.05, integrator="gauss", order=4, load=wheels(0.1, 0.1))
    torques = xarray.DataArray([0.1, 0.2, -0.3]), np.array([-0.1, 0.05, 0.4])
    over = {f"load.{k}.torque": values for k, values in enumerate(torques)}
    table = {"combine": "together", "variables": ["material_angular_velocity", "total_momentum", "wheel_speed"]}
    many = sweep(problem, tmp_path / "store", over=over, **table)
    for k, pair in enumerate(np.transpose(torques)):
        run = simulate(problem.replace(load=wheels(*pair))).isel(time=-1)
        assert np.array_equal(many.material_angular_velocity[k], run.material_angular_velocity)
        assert np.array_equal(many.wheel_speed[k], run.wheel_speed)
        assert many.wheel.values.tolist() == run.wheel.values.tolist()
    at_start = np.linalg.norm([0.6, 0.36, 0.48])  # of the wheels alone
    np.testing.assert_allclose(np.linalg.norm(many.total_momentum, axis=1), at_start, rtol=1e-12)
    assert np.array_equal(sweep(problem, tmp_path / "store", over=over, **table).status, [0, 0, 0])


def test_python_values_are_checked(tmp_path):
    problem = Problem(standard([3, 4, 5]), t_end=1, step=0.5, material_angular_velocity=(1, 2, 3))
    velocity, t_end = "start.angular_velocity.body.0", {"time.t_end": [2.0]}
    for over, words, *table in (
        ({"body.inertai": [1]}, "body.inertia"),
        ({"time.t_end": 2.0}, "a list of numbers"),
        (t_end, "did you mean variables", "variable", ["mu"]),
        (t_end, "the load has no wheels", "variables", ["wheel_speed"]),
        ({velocity: [2.0, 1e70]}, r"values\.1: 1e\+70 -> "),  # no store of it could be read
        ({velocity: [10**5000]}, r"values\.0: 1e4000 -> "),
        ({velocity: [-np.inf]}, r"values\.0: -inf -> "),
        ({}, "1 to 100"),
    ):
        with pytest.raises(RunFileError, match=words):
            sweep(problem, tmp_path / "none", over=over, **dict([table] if table else []))
    other = {"time.t_end": {"key": "time.step", "kind": "list", "values": [0.5]}}
    function = problem.replace(load=nt.moment(lambda t, d, w: 0 * w))
    turning = problem.replace(load=wheel("x", 0.2, torque=lambda t, speed: 0.1))
    for file, over, words in (
        (problem, ["time.t_end"], "over must be a mapping"),
        (problem, other, "has a key of its own, 'time.step'"),
        (problem, None, "give over="),
        (problem.system, None, "problem must be a path, a string or"),
        (problem.system, t_end, "problem must be a path, a string or"),
        (function, t_end, "kind function has no place"),
        (turning, {"load.0.speed": [1, 2]}, "of the kind wheel with a function has no place"),
    ):
        with pytest.raises(ValueError, match=words):
            sweep(file, tmp_path / "none", over=over)
    with pytest.raises(TypeError, match="'reduce' without over="):
        sweep(problem, tmp_path / "none", reduce=["mean"])
    assert not (tmp_path / "none").exists()


def test_store_of_other_values(tmp_path):
    problem, key = Problem(standard([3, 4, 5]), t_end=1, step=0.5), "start.angular_velocity.body.0"
    numbers = range(500)
    sweep(problem, tmp_path / "store", over={key: numbers}, variables=["kinetic_energy"])
    words = r"it was made with over = \.\.\..* 499\.0\] }\], the file now has over = \.\.\..* 7\.5\] }\]; choose"
    with pytest.raises(SweepStoreError, match=words) as caught:
        sweep(problem, tmp_path / "store", over={key: [*numbers[:-1], 7.5]}, variables=["kinetic_energy"])
    assert len(str(caught.value)) < 400 + len(str(tmp_path))


@pytest.mark.parametrize(("name", "values"), [("mass", [1.5, 2.0]), ("centre_of_mass", [[0, 0, 0.6], [0.1, 0, 0.5]])])
def test_weight_of_a_top(name, values, tmp_path):
    how = {"t_end": 1, "step": 0.05, "material_angular_velocity": (1, 2, 3)}
    own = {"inertia": [2.0, 2.2, 1.0], "mass": 1.5, "centre_of_mass": [0, 0, 0.6], "gravity": [0, 0, -1.6]}
    over, kept = {f"body.{name}": values}, ["kinetic_energy"]
    many = sweep(Problem(heavy_top(**own), **how), tmp_path / "store", over=over, variables=kept)
    for found, value in zip(many.kinetic_energy.values, values, strict=True):
        assert found == simulate(heavy_top(**own | {name: value}), **how).kinetic_energy[-1]
    with pytest.raises(ValueError, match=rf"body.{name}: of this body a force is known, no mass"):
        sweep(Problem(nt.DirectorSystem.from_json(heavy_top(**own).to_json()), **how), tmp_path / "none", over=over)


def test_averages_equal_an_ensemble(tmp_path):
    how = {"t_start": 1.0, "t_end": 3.0, "step": 0.1, "integrator": "gauss"}
    problem, spins = Problem(standard([3, 4, 5]), **how, material_angular_velocity=(1.0, 2.0, 0.0)), [0.1, 0.5, 2.0]
    many = sweep(problem, tmp_path / "s", over={"start.angular_velocity.body.2": spins}, reduce=["averages"])
    starts = [(1.0, 2.0, spin) for spin in spins]
    found = nt.simulate_ensemble(problem.system, material_angular_velocity=starts, reduce="averages", **how)
    for name in ("kinetic_energy_mean", "spatial_momentum_mean"):
        np.testing.assert_allclose(many[name].values, found[name].values, rtol=1e-13, atol=1e-13)
