"""Every writer asks before it replaces, and one function opens every file that is written."""

import errno
import os
import re
from pathlib import Path
from typing import get_args, get_type_hints

import matplotlib.figure
import pytest
import zarr
from typer.models import OptionInfo

pytest.importorskip("resource")
from conftest import ended
from faults.writers import WRITERS, prepare
from nontwist import plot
from nontwist.cli import COMMANDS
from nontwist.cli.shared_options import command
from nontwist.io.whole import atomic_file, reserved_path
from refusals import says


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the writers read."""
    place, before = tmp_path_factory.mktemp("writers"), Path.cwd()
    prepare(place)
    yield place
    os.chdir(before)


def told(words, kind=OSError):
    return pytest.raises(kind, match=f"^{re.escape(words)}$")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", WRITERS)
def test_what_exists_is_not_replaced(name, folder):
    write, files = WRITERS[name]
    force = "force=True" if name in PYTHON else "--force"
    for file in {files[0], files[-1]}:
        place = folder / file
        place.write_text("mine", encoding="utf-8")
        with told(f"{file} exists; choose another name, or overwrite it: {force}"):
            write(False)
        assert place.read_text(encoding="utf-8") == "mine"
        place.unlink()
        place.mkdir()
        with told(f"{file} is not a file that could be replaced; choose another name"):
            write(True)
        place.rmdir()
        in_use = f"another process is writing {file}; wait for it, or choose another name"
        with reserved_path(place), told(in_use, BlockingIOError if name in PYTHON else OSError):
            write(True)
        assert not any((folder / other).exists() for other in files)


PYTHON = {"save_run", "plot.save", "View.save", "Table.write", "save_film"}


@pytest.mark.parametrize("name", sorted(WRITERS.keys() - PYTHON - {"reproduce"}))
def test_commands_say_what_they_wrote(name, folder, request):
    if "png" not in name:  # whose frames are put together
        request.getfixturevalue("undrawn")
    write, files = WRITERS[name]
    words = write(False).split()
    for file in files:
        (folder / file).unlink()
        assert any(word.strip(",;").endswith(file) for word in words), file


def test_writers_leave_no_files_open(tmp_path):
    import fcntl

    held = os.open(tmp_path / ".b.nc.lock", os.O_CREAT | os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_EX)
    before = os.listdir("/dev/fd")
    for _ in range(3):
        with reserved_path(tmp_path / "a.nc", force=True) as place, atomic_file(place) as file:
            file.write(b"a")
        with pytest.raises(BlockingIOError, match="another process"), reserved_path(tmp_path / "b.nc"):
            pass
    assert os.listdir("/dev/fd") == before
    os.close(held)


def test_refusals_come_before_the_work(folder, monkeypatch):
    """A command that would be refused when all is computed computes nothing."""

    def worked(*arguments, **how):
        raise AssertionError("it worked first")

    for place in (
        "paper.tables.simulate",
        *("compare", "validate", "view", "open_run", "read_motion", "sweep_member", "simulate"),
        "sweeps.opening.draw",
    ):
        monkeypatch.setattr(f"nontwist.{place}", worked)
    for name in WRITERS.keys() - PYTHON - {"example"}:
        write, files = WRITERS[name]
        (folder / files[-1]).write_text("mine", encoding="utf-8")
        with pytest.raises(OSError, match="exists; choose another name"):
            write(False)
        (folder / files[-1]).unlink()


def test_impossible_store(folder, monkeypatch):
    def full(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = {*folder.iterdir()}
    monkeypatch.setattr(zarr, "consolidate_metadata", full)
    result = ended(5, "sweep", "many.toml", "--out", "new.zarr", "--workers", "1")
    assert result.stderr == f"{folder}/new.zarr: No space left on device\n"
    assert {*folder.iterdir()} == before


def is_output(annotation):
    """Whether the parameter of a command is an option that names a file."""
    kind, *more = get_args(annotation) or [annotation]
    return any(isinstance(one, OptionInfo) for one in more) and Path in (kind, *get_args(kind))


def test_commands_ask_before_replacing():
    """A new command with an option that names a file cannot be forgotten; sweep completes the store of its file."""
    options = {name: get_type_hints(command(one), include_extras=True) for name, one in COMMANDS.items()}
    writing = {name for name, hints in options.items() if any(is_output(hint) for hint in hints.values())}
    asking = {name for name, hints in options.items() if "force" in hints}
    assert asking == writing - {"sweep"}
    assert asking == {name.split()[0] for name in WRITERS if name not in PYTHON}


def test_figure_of_several_files(tmp_path):
    figure, there = matplotlib.figure.Figure(), tmp_path / "a.png"
    there.write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError):
        plot.save(figure, tmp_path / "a.pdf", there)
    for name in ("a", "a.doc"):
        with says():
            plot.save(figure, tmp_path / "b.pdf", tmp_path / name)
    assert [place.name for place in tmp_path.iterdir()] == ["a.png"]
    plot.save(figure, tmp_path / "a.PDF", there, force=True)
    assert there.read_bytes()[1:4] == b"PNG"
    assert (tmp_path / "a.PDF").read_bytes()[:4] == b"%PDF"
