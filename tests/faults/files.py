"""Faults of files and stores: damaged, foreign, newer, in odd places."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import h5py
import numpy as np
import xarray

from nontwist import nontwisting, open_run, open_sweep, save_run, simulate, sweep
from nontwist.errors import ResultFileError, SweepStoreError
from nontwist.io.results import LENGTH, SEAL


def a_run(steps: int = 100) -> xarray.Dataset:
    """A run of a free body."""
    return simulate(nontwisting([3, 4, 5]), t_end=1, step=1 / steps, material_angular_velocity=(1, 2, 0))


def refusal(path: Path) -> str:
    """Return why a file is refused, without its folder."""
    try:
        open_run(path)
    except ResultFileError as error:
        reason = str(error).replace(f"{path.parent}/", "")
    else:
        raise AssertionError(f"{path.name} was read")
    assert "\n" not in reason, reason
    return reason


def flipped_bits(folder: Path) -> str:
    """One bit flipped in every 4 kB of a result file; 100 times."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(1000), path)
    sound = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    starts = np.arange(0, sound.size, 4096)
    for _ in range(100):
        damaged = sound.copy()
        at = np.minimum(starts + rng.integers(0, 4096, starts.size), sound.size - 1)
        damaged[at] ^= 1 << rng.integers(0, 8, starts.size).astype(np.uint8)
        path.write_bytes(damaged.tobytes())
        reason = refusal(path)
    return f"detected 100 times out of 100: “{reason}”"


def one_flipped_bit(folder: Path) -> str:
    """One bit flipped anywhere in a result file, and in every byte of its seal; 1000 times."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(), path)
    sound = path.read_bytes()
    for at in [*rng.integers(0, len(sound), 1000 - LENGTH), *range(len(sound) - LENGTH, len(sound))]:
        damaged = bytearray(sound)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        refusal(path)
    return "detected 1000 times out of 1000"


def cut_off(folder: Path) -> str:
    """A result file cut off at 50 places."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(), path)
    sound = path.read_bytes()
    for length in [1, len(sound) - 1, *rng.integers(1, len(sound), 48)]:
        path.write_bytes(sound[:length])
        reason = refusal(path)
    return f"refused each time, the last with “{reason}”"


def foreign(folder: Path) -> str:
    """A text file, a pickle and another program's NetCDF file, read as results."""
    path, reasons = folder / "run.nc", []
    for data in (b"time,x\n0,1\n", b"\x80\x05cos\nsystem\n(S'true'\ntR."):
        path.write_bytes(data)
        reasons.append(refusal(path))
    xarray.Dataset({"a": 1}).to_netcdf(path, engine="h5netcdf")
    reasons.append(refusal(path))
    return "; ".join(f"“{reason}”" for reason in reasons).replace("\\", "\\\\")


def newer(folder: Path) -> str:
    """A result file from a later version of the package."""
    save_run(a_run().assign_attrs(format_version=99), folder / "run.nc")
    return f"“{refusal(folder / 'run.nc')}”"


def existing_output(folder: Path) -> str:
    """A run saved under the name of an existing file."""
    path = folder / "run.nc"
    path.write_text("mine", encoding="utf-8")
    try:
        save_run(a_run(), path)
    except FileExistsError as error:
        message = str(error).replace(f"{folder}/", "")
    else:
        raise AssertionError("it was replaced")
    assert path.read_text(encoding="utf-8") == "mine"
    save_run(a_run(), path, force=True)
    open_run(path)
    return f"“{message}”; overwritten with force=True"


def odd_names(folder: Path) -> str:
    """Results under names with spaces, letters of three scripts, quotes, a line break, a first hyphen, 200 letters."""
    names = ["a b", "Größe ψ", "回転 運動", 'it\'s "here"', "two\nlines", "x" * 200, "-rf", "a%20b#c?d"]
    for name in (os.fsdecode(name.encode()) for name in names):
        place = folder / name[:50]
        place.mkdir()
        save_run(a_run(), place / f"{name}.nc")
        assert open_run(place / f"{name}.nc").sizes["time"] == 101
        assert [file.name for file in place.iterdir()] == [f"{name}.nc"]
    return f"written and read under {len(names)} such names"


def kept_elsewhere(folder: Path) -> str:
    """A result whose numbers are stored in another file, which HDF5 would read; the result is sealed again."""
    path, secret = folder / "run.nc", folder / "secret"
    save_run(a_run(), path)
    path.write_bytes(path.read_bytes()[:-LENGTH])
    secret.write_bytes(np.arange(101.0).tobytes())
    with h5py.File(path, "r+") as file:
        del file["kinetic_energy"]
        file.create_dataset("kinetic_energy", 101, "f8", external=[(secret, 0, 808)])
    content = path.read_bytes()
    path.write_bytes(content + SEAL.format(len(content), zlib.crc32(content)).encode())
    return f"“{refusal(path)}”"


SWEEP = """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity.body = [0, 1, 0]
time = { t_end = 1, step = 0.1 }
sweep.over = [{ key = "start.angular_velocity.body.1", kind = "grid", start = 1, end = 4, count = 4 }]
"""


def flipped_bits_of_a_store(folder: Path) -> str:
    """One bit flipped in a file of a sweep store, for each of its files in turn."""
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    store, rng, reasons = folder / "sweep.zarr", np.random.default_rng(0), []
    sweep(folder / "sweep.toml", store, block=2, workers=1)
    files = sorted(file for file in store.rglob("*") if file.is_file())
    for file in files:
        sound = file.read_bytes()
        damaged = bytearray(sound)
        damaged[rng.integers(len(sound))] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        try:
            open_sweep(store).compute(scheduler="synchronous")
        except SweepStoreError as error:
            reasons.append(str(error).replace(f"{folder}/", ""))
        file.write_bytes(sound)
    assert len(reasons) == len(files), reasons
    return f"noticed {len(reasons)} times of {len(files)}, the last with “{reasons[-1]}”, one with “{reasons[5]}”"


def exchanged_blocks(folder: Path) -> str:
    """Two blocks of a sweep store exchanged, each with its marker; then the sweep run again."""
    (folder / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    store = folder / "sweep.zarr"
    sound = sweep(folder / "sweep.toml", store, block=2, workers=1).compute()
    pairs = [("c.0", "c.1"), ("c.0.0", "c.1.0"), ("000000.json", "000001.json")]
    for one, two in [(file, file.with_name(b)) for a, b in pairs for file in store.rglob(a)]:
        content = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(content)
    try:
        open_sweep(store).compute(scheduler="synchronous")
    except SweepStoreError as error:
        reason = str(error).replace(f"{folder}/", "")
    else:
        raise AssertionError("they were read")
    assert sweep(folder / "sweep.toml", store, workers=1).compute().identical(sound)
    return f"“{reason}”; both are computed again"


FAULTS = (
    flipped_bits,
    one_flipped_bit,
    cut_off,
    foreign,
    kept_elsewhere,
    newer,
    existing_output,
    odd_names,
    flipped_bits_of_a_store,
    exchanged_blocks,
)
LONG = ()
