"""Faults of files: damaged, cut off, in odd places."""

import os
from functools import cache

import numpy as np

from nontwist import nontwisting, open_run, save_run, simulate
from nontwist.errors import ResultFileError
from nontwist.io.run_files import LENGTH


@cache
def a_run(steps=100):
    """A run of a free body."""
    return simulate(nontwisting([3, 4, 5]), t_end=1, step=1 / steps, material_angular_velocity=(1, 2, 0))


def refusal(path):
    """Return why a file is refused, without its folder."""
    try:
        open_run(path)
    except ResultFileError as error:
        reason = str(error).replace(f"{path.parent}/", "")
    else:
        raise AssertionError(f"{path.name} was read")
    assert "\n" not in reason, reason
    return reason


def one_flipped_bit(folder):
    """One bit flipped anywhere in a result file, and in every byte of its seal; 300 times."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(), path)
    sound = path.read_bytes()
    for at in [*rng.integers(0, len(sound), 300 - LENGTH), *range(len(sound) - LENGTH, len(sound))]:
        damaged = bytearray(sound)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        refusal(path)
    return "detected 300 times out of 300"


def cut_off(folder):
    """A result file cut off at 50 places."""
    path, rng = folder / "run.nc", np.random.default_rng(0)
    save_run(a_run(), path)
    sound = path.read_bytes()
    for length in [1, len(sound) - 1, *rng.integers(1, len(sound), 48)]:
        path.write_bytes(sound[:length])
        reason = refusal(path)
    return f"refused each time, the last with “{reason}”"


def odd_names(folder):
    """Results under names with spaces, letters of three scripts, quotes, a line break, a first hyphen, 200 letters."""
    names = ["a b", "Größe ψ", "回転 運動", 'it\'s "here"', "two\nlines", "x" * 200, "-rf", "a%20b#c?d"]
    for name in (os.fsdecode(name.encode()) for name in names):
        place = folder / name[:50]
        place.mkdir()
        save_run(a_run(), place / f"{name}.nc")
        assert open_run(place / f"{name}.nc").sizes["time"] == 101
        assert [file.name for file in place.iterdir()] == [f"{name}.nc"]
    return f"written and read under {len(names)} such names"


FAULTS = (one_flipped_bit, cut_off, odd_names)
LONG = ()
