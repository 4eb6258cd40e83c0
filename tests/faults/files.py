"""Faults of files: damaged, foreign, newer, in odd places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray

from nontwist import ResultFileError, nontwisting, open_run, save_run, simulate


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
    return f"noticed 100 times of 100: “{reason}”"


def one_flipped_bit(folder: Path) -> str:
    """One bit flipped anywhere in a result file; 1000 times."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(), path)
    sound = path.read_bytes()
    for at in rng.integers(0, len(sound), 1000):
        damaged = bytearray(sound)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        refusal(path)
    return "noticed 1000 times of 1000"


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
    """A result file of a later version of the package."""
    save_run(a_run().assign_attrs(format_version=99), folder / "run.nc")
    return f"“{refusal(folder / 'run.nc')}”"


def existing_output(folder: Path) -> str:
    """A run saved where there is a file already."""
    path = folder / "run.nc"
    path.write_text("mine")
    try:
        save_run(a_run(), path)
    except FileExistsError as error:
        message = str(error).replace(f"{folder}/", "")
    else:
        raise AssertionError("it was replaced")
    assert path.read_text() == "mine"
    save_run(a_run(), path, force=True)
    open_run(path)
    return f"“{message}”; replaced when that was allowed"


def odd_names(folder: Path) -> str:
    """Results in folders and files with spaces, letters of three scripts, quotes, a line break, and 200 letters."""
    names = ["a b", "Größe ψ", "回転 運動", 'it\'s "here"', "two\nlines", "x" * 200, "-rf", "a%20b#c?d"]
    for name in names:
        place = folder / name[:50]
        place.mkdir()
        save_run(a_run(), place / f"{name}.nc")
        assert open_run(place / f"{name}.nc").sizes["time"] == 101
        assert [file.name for file in place.iterdir()] == [f"{name}.nc"]
    return f"written and read under {len(names)} such names"


FAULTS = (flipped_bits, one_flipped_bit, cut_off, foreign, newer, existing_output, odd_names)
LONG = ()
