"""Sealed stores of sweeps: whatever changes a file of a store is noticed, or changes nothing that is returned."""

import json
import pickle
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from zarr.storage import LocalStore

from conftest import ended
from nontwist import nontwisting, open_run, open_sweep, plot, resample, simulate, sweep, view
from nontwist.errors import SweepStoreError
from nontwist.integrators.split import fractions
from nontwist.sweeps.store import ABSENT, SEAL, Blocks, open_store
from refusals import says

OLD = Path(__file__).parents[1] / "data" / "0.1.0.zip"  # a run, a sweep file and its store, written by nontwist 0.1.0
AGAIN = "run the sweep again to recompute the block"
REMEDY = "run the sweep into a new store, or read this one unchecked with open_sweep(..., verify=False)"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The sweep file, its store in blocks of one member, of which that of member 2 is refused, and the old files."""
    folder = tmp_path_factory.mktemp("made")
    with zipfile.ZipFile(OLD) as files:
        files.extractall(folder)
    sweep(folder / "axes.toml", folder / "axes.zarr", block=1, workers=1)
    return folder


@pytest.fixture
def place(made, tmp_path):
    """A copy of all that; its store is `place / "axes.zarr"`."""
    return Path(shutil.copytree(made, tmp_path / "copy"))


def refused(store, wanted):
    """Assert that a store is refused with exactly these words when it is opened and read."""
    with pytest.raises(SweepStoreError, match=f"^{re.escape(f'{store}{wanted}')}$"):
        open_sweep(store).compute()


def replace(file, old, new):
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")


def chunk(store, name, k):
    return open_store(store, verify=False).blocks.chunk(name, k)


def test_metadata_are_sealed(place):
    store = place / "axes.zarr"
    whole = open_sweep(store)
    assert (whole.attrs["sweep_format"], whole.attrs["verified"]) == (3, 1)
    assert whole.attrs["seal"] == open_store(store).blocks.seal
    replace(store / "zarr.json", "values = [4.5,", "values = [4.6,")
    words = f" is damaged: zarr.json was changed after it was written; {REMEDY}"
    refused(store, words)
    for command in (["sweep-verify", store], ["sweep", place / "axes.toml", "--out", store]):
        assert words in ended(3, *command).stderr
    unchecked = open_sweep(store, verify=False)
    assert (unchecked.attrs["verified"], unchecked.attrs["seal"]) == (0, "not read: verify=False")
    assert unchecked["body.inertia.2.2"][0] == 4.6
    assert unchecked.quaternion.equals(whole.quaternion)
    known = whole.quaternion.compute()
    next((store / "blocks" / "000").glob("*1.json")).unlink()  # a marker alone: the numbers are still there
    assert open_sweep(store, verify=False).quaternion.equals(known)


@pytest.mark.parametrize("name", ["status/zarr.json", "blocks/seal.json"])
def test_metadata_is_sealed(place, name):
    store = place / "axes.zarr"
    (store / name).write_bytes((store / name).read_bytes() + b" ")
    refused(store, f" is damaged: {name} was changed after it was written; {REMEDY}")
    (store / name).unlink()
    refused(store, f" is damaged: {name} is missing; {REMEDY}")


def test_bad_blocks_are_made_again(place, tmp_path):
    store, other, text = place / "axes.zarr", tmp_path / "other.zarr", place / "axes.toml"
    replace(text, "6.5]", "6.5, 5.1, 5.2, 5.3, 5.4]")
    shutil.rmtree(store)
    sweep(text, store, block=1, workers=1)
    before = open_store(store).verified()
    assert (before.complete, before.blocks) == (True, 9)
    replace(text, "seed = 7", "seed = 8")
    sweep(text, other, block=1, workers=1)
    replace(text, "seed = 8", "seed = 7")

    def files(of, k):
        kept = open_store(of, verify=False)
        return [kept.blocks.place(k), *(kept.blocks.chunk(name, k) for name in kept.names)]

    for a, b in zip(files(store, 0), files(store, 1), strict=True):
        a.rename(tmp_path / "a")
        b.rename(a)
        (tmp_path / "a").rename(b)
    for a, b in zip(files(store, 4), files(other, 4), strict=True):
        shutil.copy(b, a)
    chunk(store, "kinetic_energy", 3).unlink()
    content = chunk(store, "quaternion", 5).read_bytes()
    chunk(store, "quaternion", 5).write_bytes(content[:11] + bytes([content[11] ^ 1]) + content[12:])
    files(store, 6)[0].write_text("{}", encoding="utf-8")
    shutil.copy(chunk(store, "quaternion", 8), chunk(store, "quaternion", 7))  # its CRC-32C is right
    files(store, 8)[0].unlink()
    (store / "quaternion" / "c.1.0.left.partial").touch()
    reasons = {
        0: "block 1 is in its place",
        1: "block 0 is in its place",
        3: "kinetic_energy is missing",
        4: "it belongs to another store",
        5: "quaternion was changed after it was written",
        6: "its marker was changed after it was written",
        7: "quaternion was changed after it was written",
    }
    found = open_store(store).verified()
    assert (found.damaged, found.missing, found.complete, found.sha256) == (reasons, (8,), False, None)
    told = [f"block {k}, members {k} to {k}: damaged: {reason}\n" for k, reason in reasons.items()]
    assert ended(1, "sweep-verify", store).stderr == "".join(["block 8, members 8 to 8: missing\n", *told])
    many = open_sweep(store)
    for k, reason in reasons.items():
        with pytest.raises(SweepStoreError) as caught:
            many.isel(member=k).compute()
        assert str(caught.value) == f"{store}: block {k}, members {k} to {k}: {reason}; {AGAIN}"
    assert many.status[2] == -1  # a block that is whole can be read beside them
    assert many.isel(member=3).quaternion.compute().size == 4
    assert open_sweep(store, verify=False).isel(member=[0, 1, 4]).compute().sizes["member"] == 3
    seen, again = [], []
    sweep(text, store, workers=1, progress=seen.append)
    after = open_store(store).verified()
    assert (len(seen), seen[-1].done, after.complete, after.sha256) == (8, 9, True, before.sha256)
    assert not list(store.glob("**/*.partial"))
    sweep(text, store, progress=again.append)
    assert again == []


def test_refused_chunk(place):
    store = place / "axes.zarr"
    refused_chunk = chunk(store, "quaternion", 2)
    assert not refused_chunk.exists()  # all of it is NaN
    shutil.copy(chunk(store, "quaternion", 1), refused_chunk)  # its CRC-32C is right
    refused(store, f": block 2, members 2 to 2: quaternion was changed after it was written; {AGAIN}")
    assert (sweep(place / "axes.toml", store, workers=1).status.values == [0, 0, -1, 0, 0]).all()
    assert not refused_chunk.exists()


def test_block_without_marker(place):
    store = place / "axes.zarr"
    running = open_sweep(store)
    open_store(store).blocks.place(3).unlink()
    many = open_sweep(store).compute()
    assert many.status.values.tolist() == [0, 0, -1, ABSENT, 0]
    assert np.isnan(many.quaternion[3]).all()
    with pytest.raises(SweepStoreError, match="block 3, members 3 to 3: its marker was removed after the store was op"):
        running.status.compute()


def test_lazy_reading(place, monkeypatch):
    store, read, sound = place / "axes.zarr", [], Blocks.array

    def noting(self, name, k, done=None):
        if self.path == store:  # threads of other stores may still be reading: Dask leaves them
            read.append((name, k))
        return sound(self, name, k, done)

    monkeypatch.setattr(Blocks, "array", noting)
    many = open_sweep(store)
    assert read == []
    many.quaternion[3].compute()
    assert read == [("quaternion", 3)]


def test_datasets_travel(place):
    store = place / "axes.zarr"
    many = pickle.loads(pickle.dumps(open_sweep(store)))
    assert many.identical(open_sweep(store))
    many.to_netcdf(place / "axes.nc", engine="h5netcdf")
    chunk(store, "status", 0).unlink()
    with pytest.raises(SweepStoreError) as caught:
        many.status.compute()
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_hash_of_the_intended(place, tmp_path, monkeypatch):
    sound = LocalStore.set

    async def flipping(self, key, value):
        if key == "quaternion/c.1.0":
            content = bytearray(value.to_bytes())
            content[5] ^= 1
            value = type(value).from_bytes(bytes(content))
        await sound(self, key, value)

    monkeypatch.setattr(LocalStore, "set", flipping)
    sweep(place / "axes.toml", tmp_path / "store", block=1, workers=1)
    assert open_store(tmp_path / "store").verified().damaged == {1: "quaternion was changed after it was written"}


@pytest.mark.parametrize("flips", [20, pytest.param(2000, marks=pytest.mark.long)])
def test_flipped_bits(place, flips):
    store, rng = place / "axes.zarr", np.random.default_rng(flips)
    sound = open_sweep(store).compute()
    files = sorted(file for file in store.rglob("*") if file.is_file())
    sizes = [file.stat().st_size for file in files]
    noticed = 0
    for _ in range(flips):
        file = files[rng.choice(len(files), p=np.array(sizes) / sum(sizes) / 2 + 0.5 / len(files))]
        content = file.read_bytes()
        damaged = bytearray(content)
        damaged[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        try:
            assert flips < 2000 or not open_store(store).verified().complete, file  # sweep-verify notices it as well
            assert open_sweep(store).compute(scheduler="synchronous").identical(sound), file
        except SweepStoreError:
            noticed += 1
        file.write_bytes(content)
    assert noticed == flips
    assert open_sweep(store).compute().identical(sound)


def test_foreign_files(place):
    store = place / "axes.zarr"
    before = open_sweep(store).compute()
    for name in (".zgroup", ".zattrs", ".zmetadata", "quaternion/.zarray", "other/zarr.json", "blocks/000/000009.json"):
        (store / name).parent.mkdir(exist_ok=True)
        (store / name).write_text('{"zarr_format": 2}', encoding="utf-8")
    assert open_sweep(store).compute().identical(before)
    assert open_store(store).verified().complete


NO_SWEEP = " is not the store of a sweep, or is damaged: "
UNSEALED = {
    NO_SWEEP + "JSONDecodeError: Unterminated string": lambda text: text[:200],
    NO_SWEEP + "KeyError: 'run": lambda text: text.replace('"run_file":', '"run_fyle":'),
    NO_SWEEP + "ValueError: block 0": lambda text: text.replace('"block": 1', '"block": 0'),
    " has sweep_format 1; this version of ": lambda text: text.replace('"sweep_format": 3', '"sweep_format": 1'),
    " is damaged: blocks/seal.json is miss": lambda text: text,
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("words", UNSEALED)
def test_unsealed_metadata(place, words):
    store = place / "axes.zarr"
    (store / SEAL).unlink()
    text = (store / "zarr.json").read_text(encoding="utf-8")
    (store / "zarr.json").write_text(UNSEALED[words](text), encoding="utf-8")
    with pytest.raises(SweepStoreError, match=f"^{re.escape(f'{store}{words}')}"):
        open_sweep(store)
    (told,) = ended(3, "sweep-show", store).stderr.splitlines()
    assert f"{store}{words}" in told


def test_result_of_a_gone_order(place):
    """It plots, is shown and continued; what needs its integrator says what to take."""
    old, how = open_run(place / "run.nc"), {"t_end": 2, "step": 0.25}
    assert json.loads(old.attrs["integrator"]) == {"name": "lie-midpoint", "order": 4}
    with pytest.warns(UserWarning, match=r"^the run has 5 states, .* its curves are drawn as polygons; "):
        assert plot.momenta(old)
    assert "lie-midpoint, order 4" in view(old).save(place / "view.html").read_text(encoding="utf-8")
    ended(0, "info", place / "run.nc")
    rest = simulate(nontwisting([3, 4, 5]), start=old, **how)
    assert (float(rest.time[0]), rest.attrs["step"], len(rest.time)) == (1.0, 0.25, 5)
    assert np.array_equal(rest.quaternion[0], old.quaternion[-1])
    with says():
        resample(old, [0.3])


def test_result_of_0_1_0(place):
    body, W = nontwisting([3, 4, 5]), np.array([1.0, 2, 0])
    run = simulate(body, t_end=1, step=0.25, material_angular_velocity=W)
    old = open_run(place / "run.nc")
    later = {"mean_twist_rate", "spatial_reaction_moment"}  # than 0.1.0
    assert set(old.data_vars) == set(run.data_vars) - later
    turn = np.sum(2 * np.arctan(fractions(4) * 0.25 * np.sqrt(5) / 2))  # in each of its four steps
    turned = Rotation.from_rotvec(np.outer(np.arange(5) * turn, W / np.sqrt(5)))
    np.testing.assert_allclose(old.quaternion, turned.as_quat(), atol=1e-14)
