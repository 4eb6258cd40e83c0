"""Faults of the system around: full disks, read-only folders, no home, no cache, other alphabets, too little memory."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import nontwist
from nontwist import nontwisting, save_run, simulate
from nontwist.cli.result_commands import export_command
from nontwist.kernels.kernel import Kernel

from .children import answer, without_rights
from .files import a_run

SOURCE = Path(nontwist.__file__).parent


def _on_a_full_disk(path: Path, limit: int, force: bool) -> str:
    run = a_run(1000)
    _limit(limit)
    try:
        save_run(run, path, force=force)
    except OSError as error:
        return str(error).replace(f"{path.parent}/", "")
    raise AssertionError("it was written")


def _limit(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def full_disk(folder: Path) -> str:
    """No space for a result of 400 kB: only 0, 1 kB, 100 kB, 99 % of it, or all but the seal can be written."""
    whole = folder / "whole.nc"
    save_run(a_run(1000), whole)
    size = whole.stat().st_size
    for limit in (0, 1000, 100_000, int(0.99 * size), size - 1):
        message = answer(_on_a_full_disk, folder / "run.nc", limit, False)
        assert os.listdir(folder) == ["whole.nc"], os.listdir(folder)
    before = whole.read_bytes()
    answer(_on_a_full_disk, whole, 100_000, True)
    assert whole.read_bytes() == before
    assert os.listdir(folder) == ["whole.nc"], os.listdir(folder)
    return f"“{message}”, nothing is left behind; a file that was to be replaced remains complete"


def _exporting_on_a_full_disk(result: Path, out: Path, to: str) -> str:
    _limit(10_000)
    try:
        export_command(result, to, out)  # type: ignore[arg-type]
    except OSError as error:
        return type(error).__name__
    raise AssertionError("it was written")


def full_disk_export(folder: Path) -> str:
    """No space for the output of `nontwist export`: CSV, NPZ, JSON."""
    save_run(a_run(1000), folder / "run.nc")
    for to in ("csv", "npz", "json"):
        answer(_exporting_on_a_full_disk, folder / "run.nc", folder / f"out.{to}", to)
    assert os.listdir(folder) == ["run.nc"], os.listdir(folder)
    return "an OSError each time (status 5), nothing is left behind"


@contextlib.contextmanager
def _open_to_all() -> Iterator[Path]:
    """A folder that other users reach."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def _in_a_read_only_folder(path: Path, elsewhere: Path) -> str:
    run = a_run()
    save_run(run, elsewhere)
    without_rights()
    try:
        save_run(run, path)
    except PermissionError as error:
        return str(error).replace(f"{path.parent}/", "")
    raise AssertionError("it was written")


def read_only_folder(folder: Path) -> str:
    """A result for a read-only folder."""
    with _open_to_all() as place:
        place.chmod(0o555)
        message = answer(_in_a_read_only_folder, place / "run.nc", folder / "run.nc")
        assert os.listdir(place) == []
        place.chmod(0o755)
    return f"“{message}”"


def _homeless(home: str) -> None:
    """Leave no folder where the user's files could go, and no right to make one."""
    os.environ.pop("XDG_CACHE_HOME", None)
    os.environ["HOME"] = home
    without_rights()


def _command(*arguments: str, **environment: str | None) -> subprocess.CompletedProcess[bytes]:
    variables = {**os.environ, "PYTHONPATH": str(SOURCE.parent), **environment}
    known = {name: value for name, value in variables.items() if value is not None}
    command = [sys.executable, "-m", "nontwist", *arguments]
    return subprocess.run(command, env=known, capture_output=True, check=False)


ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": None}


def other_alphabet(folder: Path) -> str:
    """A terminal and a file system that support only ASCII (LC_ALL=C, no UTF-8 mode), and a file called ψ.nc."""
    path = folder / os.fsdecode("ψ run.nc".encode())
    save_run(a_run().assign_attrs(title="Π⊥ of a body"), path)
    result = _command("info", str(path), **ASCII)
    assert result.returncode == 0, result.stderr
    assert b"of a body" in result.stdout
    result.stdout.decode("ascii")
    facts = json.loads(_command("info", "--json", str(path), **ASCII).stdout)
    assert facts["title"] == "Π⊥ of a body"
    missing = _command("info", str(folder / os.fsdecode("φ.nc".encode())), **ASCII)
    assert missing.returncode == 5, missing.stderr
    assert b"Traceback" not in missing.stderr
    return "the result is read; letters that cannot be displayed are replaced by question marks, and escaped in JSON"


def no_home(folder: Path) -> str:
    """No HOME, no XDG folders, for `nontwist info` and `nontwist export`."""
    save_run(a_run(), folder / "run.nc")
    gone = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "USER", "LOGNAME"))
    for arguments in (("info",), ("export",)):
        done = _command(*arguments, str(folder / "run.nc"), **gone)
        assert done.returncode == 0, done.stderr
        assert all(line.startswith(b"next: ") for line in done.stderr.splitlines()), done.stderr
    return "both work as usual"


def no_home_simulating(folder: Path) -> str:
    """A run with the package and HOME in read-only folders."""
    with _open_to_all() as place:
        shutil.copytree(SOURCE, place / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
        for inner in [place, *place.rglob("*")]:
            inner.chmod(0o555 if inner.is_dir() else 0o444)
        before = sorted(place.rglob("*"))
        try:
            answer(_simulating_elsewhere, place)
        finally:
            for inner in [place, *place.rglob("*")]:
                inner.chmod(0o755)
        assert sorted(place.rglob("*")) == before
    return "the run completes; nothing is written"


def _simulating_elsewhere(place: Path) -> None:
    a_run()  # imports everything else while this may be read
    for name in [name for name in sys.modules if name.split(".")[0] == "nontwist"]:
        del sys.modules[name]
    sys.path.insert(0, str(place))
    _homeless(str(place))
    from nontwist.driver.runs import simulate as elsewhere
    from nontwist.models.catalogue import nontwisting as body

    assert elsewhere.__code__.co_filename.startswith(str(place))
    run = elsewhere(body([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 0))
    assert run.sizes["time"] == 101


def _compiling_on_a_full_disk() -> float:
    _limit(0)
    twice = Kernel(lambda x: x + x, "f8 -> f8")
    return float(twice(21.0))


def full_disk_for_machine_code(folder: Path) -> str:
    """No space on any disk while a kernel is compiled."""
    assert answer(_compiling_on_a_full_disk) == 42.0
    return "it is compiled in memory; nothing is written"


def too_many_steps(folder: Path) -> str:
    """A run of 10⁹ steps in which every state is to be stored."""
    try:
        simulate(nontwisting([3, 4, 5]), t_end=1e6, step=1e-3, material_angular_velocity=(1, 2, 0))
    except ValueError as error:
        message = str(error)
    else:
        raise AssertionError("it ran")
    assert re.fullmatch(r"1e\+09 stored states need 800 GB, .* GB are free; store=\d+ fits, or store='end'", message)
    return "refused beforehand: “" + re.sub(r"[\d.]+ GB are free; store=\d+", "… GB are free; store=…", message) + "”"


FAULTS = (
    full_disk,
    full_disk_export,
    read_only_folder,
    full_disk_for_machine_code,
    no_home,
    no_home_simulating,
    other_alphabet,
    too_many_steps,
)
LONG = (no_home_simulating,)
