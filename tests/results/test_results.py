"""Result files: what is written is read back, whole, or refused with the reason."""

import json
import re
import shutil
import zlib

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray

from conftest import BODIES
from nontwist import gradient, lyapunov, open_run, save_run, sensors, simulate, sine
from nontwist.errors import ResultFileError
from nontwist.io.run_files import LENGTH, SEAL, reserved
from refusals import says

HOW = {"t_end": 0.3, "step": 0.01, "angular_velocity": [1, -2, 0.5], "project": True, "load": sine([1, 2, 0.5], 3)}


@pytest.fixture(scope="module")
def run():
    return simulate(BODIES["suslov"](), **HOW, integrator="energy-momentum")


@pytest.fixture(scope="module")
def saved(run, tmp_path_factory):
    save_run(run, place := tmp_path_factory.mktemp("saved") / "run.nc")
    return place


@pytest.fixture
def path(saved, tmp_path):
    return shutil.copy(saved, tmp_path / "run.nc")


FORMS = {
    "a run": lambda run: run,
    "one state, no interval": lambda run: run.isel(time=[0], midtime=[]),
    "a moment": lambda run: run.isel(time=3),
    "thinned": lambda run: run.isel(time=slice(None, None, 2), midtime=slice(1, None, 3)),
    "long attributes, other types and coordinates": lambda run: (
        run.assign(
            flag=("midtime", np.arange(30) % 2 == 0),
            short=("midtime", np.arange(30, dtype=">f4")),
            when=("midtime", np.datetime64("2026-01-01", "ns") + np.arange(30)),
            count=7,
            name="top",
        )
        .assign_coords(label=("time", [f"ψ{k}" for k in range(31)]), member=5, day=np.datetime64("2026-01-01", "ns"))
        .assign_attrs(run_file="é\n" * 10**5, empty="", numbers=np.arange(5.0), x=2.5)
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_saved_and_read(run, tmp_path, form):
    one = FORMS[form](run)
    save_run(one, tmp_path / "run.nc")
    found = open_run(tmp_path / "run.nc")
    xarray.testing.assert_identical(found, one)
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as other:
        xarray.testing.assert_identical(other.load(), one)
    assert str(found) == str(other)  # with the types of arrays
    if "midtime" in one.dims:
        with h5py.File(tmp_path / "run.nc") as file:
            assert file["moment"].dims[0][0].name == "/midtime"


def test_other_results(run, tmp_path):
    """What sensors and functions of derivatives and of chaos return, and what has lost its attributes, is read back."""
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": (1, 2, 0)}
    slopes = gradient(BODIES["standard"](), d_rotation=np.ones((2, 3)), store="end", **how)
    for one in (sensors.gyroscope(run), lyapunov(BODIES["standard"](), **how), slopes, run.drop_attrs()):
        save_run(one, tmp_path / "other.nc", force=True)
        found = open_run(tmp_path / "other.nc")
        assert found.attrs.pop("format_version") == 1
        xarray.testing.assert_identical(found, one)


def version(number):
    return lambda run, path: save_run(run.assign_attrs(format_version=number), path)


OTHERS = {
    "empty": lambda run, path: path.write_bytes(b""),
    "text": lambda run, path: path.write_text("time,x\n0,1\n", encoding="utf-8"),
    "pickle": lambda run, path: path.write_bytes(b"\x80\x05cos\nsystem\n"),
    "another program's": lambda run, path: xarray.Dataset({"a": 1}).to_netcdf(path, engine="h5netcdf"),
    "newer": version(99),
    "odd version": version("one"),
    "joined": lambda run, path: (
        save_run(run, path),
        path.write_bytes(path.read_bytes() + path.read_bytes()[-LENGTH:]),
    ),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_no_run(run, tmp_path, kind):
    path = tmp_path / "run.nc"
    OTHERS[kind](run, path)
    with says(ResultFileError) as info:
        open_run(path)
    assert str(info.value).startswith(str(path))


def test_without_a_seal(run, path):
    with h5py.File(path, "r+") as file:  # HDF5 cuts the seal off
        file["kinetic_energy"][3] = 0.0
    with pytest.warns(UserWarning, match="unverified"):
        assert open_run(path).kinetic_energy[3] == 0
    run.to_netcdf(path, engine="h5netcdf")
    with pytest.warns(UserWarning, match=r"run\.nc has no seal: .*; it is read, unverified"):
        assert open_run(path).identical(run)


def sealed_again(path):
    """Seal a file as who can write it could."""
    content = path.read_bytes()
    path.write_bytes(content + SEAL.format(len(content), zlib.crc32(content)).encode())


def virtual_array(file, other):
    layout = h5py.VirtualLayout(31, "f8")
    layout[:] = h5py.VirtualSource(other, "secret", 31)
    file.create_virtual_dataset("kinetic_energy", layout)


ELSEWHERE, LINK = "the numbers of 'kinetic_energy' are kept in other files", "is a link to another place or file"
OUTSIDE = {
    lambda file, other: file.create_dataset("kinetic_energy", 31, "f8", external=[(other, 0, 248)]): ELSEWHERE,
    virtual_array: ELSEWHERE,
    lambda file, other: file.__setitem__("kinetic_energy", h5py.ExternalLink(other, "x")): f"'kinetic_energy' {LINK}",
    lambda file, _: file.__setitem__("kinetic_energy", h5py.SoftLink("/time")): f"'kinetic_energy' {LINK}",
    lambda file, other: file.__setitem__("group/there", h5py.ExternalLink(other, "/")): f"'there' {LINK}",
}


@pytest.mark.parametrize("make", OUTSIDE)
def test_file_that_reads_others(path, tmp_path, make):
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["secret"] = np.arange(31.0)
    path.write_bytes(path.read_bytes()[:-LENGTH])
    with h5py.File(path, "r+") as file:
        file["group/back"] = file["/"]  # hard links make rings, which are no harm
        del file["kinetic_energy"]
        make(file, other)
    sealed_again(path)
    with pytest.raises(ResultFileError) as caught:
        open_run(path)
    assert str(caught.value) == f"{path} was not written by save_run: {OUTSIDE[make]}"


def test_deceiving_file(path):
    path.write_bytes(path.read_bytes()[:-LENGTH])
    with h5netcdf.File(path, "r+") as file:
        file.dimensions["many"] = 10**12
        file.create_variable("huge", ("time", "many"), "f8", chunks=(1, 10**6))
    sealed_again(path)
    words = rf"up to 'huge' its arrays take 2480000\d+ bytes, but it has {path.stat().st_size}$"
    with pytest.raises(ResultFileError, match=words):
        open_run(path)
    path.write_bytes(b"no HDF5 at all")
    sealed_again(path)
    with pytest.raises(ResultFileError, match=r"run\.nc cannot be read: OSError: "):
        open_run(path)


def test_nothing_is_executed(run, tmp_path):
    """Strings come back as strings, and no object survives."""
    hostile = "__import__('os').system('true')"
    save_run(run.assign_attrs(run_file=hostile, load=json.dumps([{"function": hostile}])), tmp_path / "a.nc")
    assert open_run(tmp_path / "a.nc").attrs["run_file"] == hostile
    with pytest.raises(TypeError):
        save_run(run.assign_attrs(bad=object()), tmp_path / "b.nc")
    with pytest.raises((TypeError, ValueError)):
        save_run(run.assign(bad=("time", np.array([object()] * 31))), tmp_path / "b.nc")
    assert [file.name for file in tmp_path.iterdir()] == ["a.nc"]


def test_unwritable(run, tmp_path):
    path = tmp_path / "run.CSV"
    export = f"{path}: save_run writes NetCDF, NAME.nc; nontwist export NAME.nc --out {path} writes that"
    file = "is not a file that could be replaced; choose another name"
    for place, error, words in (
        (path, ValueError, re.escape(export)),
        (tmp_path / "none" / "run.nc", FileNotFoundError, r"there is no folder .*none; make it first"),
        (tmp_path, OSError, file),
        ("/dev/null", OSError, file),
    ):
        with pytest.raises(error, match=words):
            save_run(run, place, force=True)
    assert not path.exists()
    with pytest.raises(FileNotFoundError, match="no such file"):
        open_run(tmp_path / "none.nc")


def test_link_still_points(run, tmp_path):
    link, true = tmp_path / "run.nc", tmp_path / "true.nc"
    link.symlink_to(true)
    save_run(run, link)
    assert link.is_symlink()
    assert open_run(true).identical(open_run(link))


def test_reserved_output(run, tmp_path):
    path = tmp_path / "run.nc"
    with reserved(path) as write:
        with pytest.raises(BlockingIOError, match=r"another process is writing .*run\.nc; wait for it, or choose"):
            save_run(run, path)
        write(run)
        write(run.assign_attrs(title="twice"))
    assert open_run(path).attrs["title"] == "twice"
    with pytest.raises(ZeroDivisionError), reserved(tmp_path / "other.nc"):
        1 / 0  # noqa: B018
    assert [file.name for file in tmp_path.iterdir()] == ["run.nc"]


def test_left_by_a_killed_process(run, tmp_path):
    for name in (".run.nc.part", ".run.nc.lock"):
        (tmp_path / name).write_bytes(b"half a file")
    save_run(run, tmp_path / "run.nc")
    assert [file.name for file in tmp_path.iterdir()] == ["run.nc"]
