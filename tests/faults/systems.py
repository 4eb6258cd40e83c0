"""Faults of the system around: full disks, read-only folders, no home, no cache, other alphabets, too little memory."""

import contextlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from typer.testing import CliRunner

import nontwist
from nontwist import save_run
from nontwist.cli import app

from .children import answer, without_rights
from .files import a_run

SOURCE = Path(nontwist.__file__).parent


def _refused(writing, *arguments):
    """Return what is said of something that cannot be written, without its folder."""
    try:
        writing(*arguments)
    except OSError as error:
        return re.sub(r"/\S*/", "", str(error))
    raise AssertionError("it was written")


def _limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def _saving(path, limit, force):
    run = a_run(1000)
    _limit(limit)
    save_run(run, path, force=force)


def full_disk(folder):
    """No space for a result of 400 kB: only 0, 1 kB, 100 kB, 99 % of it, or all but the seal can be written."""
    whole = folder / "whole.nc"
    save_run(a_run(1000), whole)
    size = whole.stat().st_size
    for limit in (0, 1000, 100_000, int(0.99 * size), size - 1):
        message = answer(_refused, _saving, folder / "run.nc", limit, False)
        assert os.listdir(folder) == ["whole.nc"], os.listdir(folder)
    before = whole.read_bytes()
    answer(_refused, _saving, whole, 100_000, True)
    assert whole.read_bytes() == before
    assert os.listdir(folder) == ["whole.nc"], os.listdir(folder)
    return f"“{message}”, nothing is left behind; a file that was to be replaced remains complete"


@contextlib.contextmanager
def _open_to_all():
    """A folder that other users reach."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def _saving_without_rights(path, elsewhere):
    run = a_run()
    save_run(run, elsewhere)
    without_rights()
    save_run(run, path)


def read_only_folder(folder):
    """A result for a read-only folder."""
    with _open_to_all() as place:
        place.chmod(0o555)
        message = answer(_refused, _saving_without_rights, place / "run.nc", folder / "run.nc")
        assert "ermission denied" in message
        assert os.listdir(place) == []
        place.chmod(0o755)
    return f"“{message}”"


def _homeless(home):
    """Leave no folder where the user's files could go, and no right to make one."""
    os.environ.pop("XDG_CACHE_HOME", None)
    os.environ["HOME"] = home
    without_rights()


COMMANDS = """
import sys
from nontwist.cli import app
for line in " ".join(sys.argv[1:]).split(" then "):
    try:
        app(line.split())
    except SystemExit as end:
        print("exit", end.code, flush=True)
"""


def _commands(*lines, **environment):
    """Return what commands of one process print and their exit status, and all of their errors."""
    variables = {**os.environ, "PYTHONPATH": str(SOURCE.parent), **environment}
    known = {name: value for name, value in variables.items() if value is not None}
    command = [sys.executable, "-c", COMMANDS, " then ".join(lines)]
    done = subprocess.run(command, env=known, capture_output=True, check=False)
    shown = re.split(rb"^exit (\d+)\n", done.stdout, flags=re.MULTILINE)
    assert (done.returncode, len(shown)) == (0, 2 * len(lines) + 1), done.stderr
    return list(zip(shown[::2], map(int, shown[1::2]), strict=False)), done.stderr


ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": None}


def other_alphabet(folder):
    """A terminal and a file system that support only ASCII (LC_ALL=C, no UTF-8 mode), and a file called ψ.nc."""
    path, none = (folder / os.fsdecode(f"{name}.nc".encode()) for name in "ψφ")
    save_run(a_run().assign_attrs(title="Π⊥ of a body"), path)
    (shown, data, missing), errors = _commands(f"info {path}", f"info --json {path}", f"info {none}", **ASCII)
    assert (shown[1], missing[1]) == (0, 5), errors
    assert "of a body" in shown[0].decode("ascii")
    assert json.loads(data[0])["title"] == "Π⊥ of a body"
    assert b"Traceback" not in errors
    return "the result is read; letters that cannot be displayed are replaced by question marks, and escaped in JSON"


def no_home_simulating(folder):
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


def _simulating_elsewhere(place):
    a_run()  # imports everything else while this may be read
    for name in [name for name in sys.modules if name.split(".")[0] == "nontwist"]:
        del sys.modules[name]
    sys.path.insert(0, str(place))
    _homeless(str(place))
    from nontwist.driver.runs import simulate as elsewhere
    from nontwist.models.bodies import nontwisting as body

    assert elsewhere.__code__.co_filename.startswith(str(place))
    run = elsewhere(body([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 0))
    assert run.sizes["time"] == 101


HELD = '[body]\nkind = "nontwisting"\ninertia = [3, 4, 5]\n\n[time]\nt_end = 1\n'
COSTLY = {
    "a sine of 1e8 Hz": HELD + '[integrator]\nname = "exact"\n[[load]]\nkind = "sine"\nframe = "body"\n'
    "amplitude = [1, 0, 0]\nfrequency = 1e8\n",
    "20,000 unknown keys": HELD + "".join(f"step_{i} = 1\n" for i in range(20_000)),
    "2e8 stored states": f"{HELD}step = 5e-9\n",
    "a grid of 1e11 values": HELD + '[sweep]\nover = [{ key = "body.inertia.0", kind = "grid", start = 3, end = 4, '
    "count = 100_000_000_000 }]\n",
}


def _checked_in_200_mb(folder):
    def check(text):
        path = folder / "run.toml"
        path.write_text(text, encoding="utf-8")
        return CliRunner().invoke(app, ["check", str(path)]).exit_code

    small = COSTLY["a sine of 1e8 Hz"].replace("1e8", "1")
    assert check(small) == 0  # imports
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
    scratch = pages * os.sysconf("SC_PAGE_SIZE") + 200_000_000
    resource.setrlimit(resource.RLIMIT_AS, (scratch, scratch))
    return {what: check(text) for what, text in COSTLY.items()}


def costly(folder):
    """`nontwist check` with 200 MB left: a sine of 1e8 Hz for `exact`, 20,000 unknown keys, 2e8 stored states.

    And a grid of 1e11 values.
    """
    codes = answer(_checked_in_200_mb, folder)
    large = codes.pop("2e8 stored states")  # in order where 160 GB are free
    assert large in (0, 3), large
    assert set(codes.values()) == {3}, codes
    return "each check ends; what cannot run is refused, with the number that would be possible"


FAULTS = (full_disk, read_only_folder, no_home_simulating, other_alphabet, costly)
LONG = (no_home_simulating,)
