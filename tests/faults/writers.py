"""Faults of every writer of the package: commands and functions."""

import os
import resource
import webbrowser
from collections.abc import Callable
from functools import cache
from math import cos, sin
from pathlib import Path
from typing import NamedTuple

from typer.testing import CliRunner

from nontwist import plot, save_run, sensors, simulate, standard, sweep, view
from nontwist.cli import app
from nontwist.paper.tables import Table
from nontwist.viewer.films import save_film

from .children import answer

RUN_FILE = """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity = { body = [1, 2, 0] }
time = { t_end = 1, step = 0.1 }
"""
SWEPT = """
sweep.over = [{ key = "start.angular_velocity.body.0", kind = "grid", start = 1, end = 2, count = 3 }]
"""
RECORDING = "t,w,x,y,z\n" + "".join(f"{k / 10},{cos(k / 20)},{sin(k / 20)},0,0\n" for k in range(20))


class Writer(NamedTuple):
    """Something that writes `files`; it raises an OSError where it cannot."""

    write: Callable[[bool], object]
    files: tuple[str, ...]


def _command(line, *files):
    def write(force):
        result = CliRunner().invoke(app, [*line.split(), *["--force"] * force], env={"COLUMNS": "200"})
        assert "Traceback" not in result.output, result.output
        if result.exit_code == 5:
            raise OSError(result.stderr.removesuffix("\n"))
        assert result.exit_code == 0, (line, result.output, result.exception)
        return result.output

    return Writer(write, files)


@cache
def _run():
    return simulate(standard([3, 4, 5]), t_end=1, step=0.1, angular_velocity=(1, 2, 0))


@cache
def _thrown():
    run = simulate(standard([1, 2, 2.5]), t_end=1, material_angular_velocity=(3, 8, 1))
    seen = sensors.gyroscope(run, noise=1e-4, rate=100)
    return "".join(f"{t},{x},{y},{z}\n" for t, (x, y, z) in zip(seen.time.values, seen.gyroscope.values, strict=True))


@cache
def _drawn():
    return plot.energy(_run())


def _figures(*names):
    return [f"{name}{suffix}" for name in names for suffix in (".pdf", ".png")]


TABLES = ("invariants.csv", "second_quotient.csv", "momenta_data.csv")
PAPER = (*(f"case1/{name}" for name in (*TABLES, *_figures("momenta"))), "index.html")

# Each works in a folder prepared by `prepare`. A command is called after its first word.
WRITERS = {
    "save_run": Writer(lambda force: save_run(_run(), "out.nc", force=force), ("out.nc",)),
    "plot.save": Writer(
        lambda force: plot.save(_drawn(), "a.pdf", "a.png", "a.svg", force=force), ("a.pdf", "a.png", "a.svg")
    ),
    "View.save": Writer(lambda force: view(_run()).save("page.html", force=force), ("page.html",)),
    "Table.write": Writer(lambda force: Table(1, "", "", ()).write(Path("table.csv"), force=force), ("table.csv",)),
    "run": _command('run run.toml --out out.nc --set output.figures=["energy"]', "out.nc", *_figures("out-energy")),
    "compare": _command("compare run.toml --integrator lie-midpoint:2 --step 0.1 --figure work.svg", "work.svg"),
    "example": _command("example sweep", "sweep.toml"),
    "export to CSV": _command("export run.nc --out out.csv", "out.csv"),
    "export to NPZ": _command("export run.nc --to npz --out out.npz", "out.npz"),
    "export to JSON": _command("export run.nc --to json --out out.json", "out.json"),
    "reproduce": _command("reproduce --quick --case 1 --out .", *PAPER),
    "twist": _command("twist turned.csv --csv --out out", "out.nc", "out.csv", *_figures("out")),
    "fit --out": _command("fit thrown.csv --all --out body.toml", "body.toml"),
    "fit --figure": _command("fit thrown.csv --all --figure fit.png", "fit.png"),
    "sweep-show --plot": _command(
        "sweep-show many.zarr --plot start.angular_velocity.body.0 quaternion --figure many.svg", "many.svg"
    ),
    "sweep-show --member": _command("sweep-show many.zarr --member 1 --out 1.nc", "1.nc"),
    "sweep-show run file": _command("sweep-show many.zarr --member 1 --out 1.toml", "1.toml"),
    "view": _command("view run.nc --no-open", "run-view.html"),
    "view --png": _command("view run.nc --no-open --out run-page.html --png run.png", "run-page.html", "run.png"),
    "save_film": Writer(lambda force: save_film([_run()], "run.gif", seconds=0.3, force=force), ("run.gif",)),
    "play": _command("play --no-open", "playground.html"),
    "validate": _command("validate --group geometry --page page.md", "page.md"),
}


def prepare(folder):
    """Make what the writers read, and work in the folder."""
    os.chdir(folder)
    Path("run.toml").write_text(RUN_FILE, encoding="utf-8")
    Path("many.toml").write_text(RUN_FILE + SWEPT, encoding="utf-8")
    Path("turned.csv").write_text(RECORDING, encoding="utf-8")
    Path("thrown.csv").write_text("t,gx (rad/s),gy (rad/s),gz (rad/s)\n" + _thrown(), encoding="utf-8")
    save_run(_run(), "run.nc")
    sweep("many.toml", "many.zarr", workers=1)
    Path("case1").mkdir()


def _there():
    return {str(place): place.read_bytes() for place in Path().rglob("*") if place.is_file()}


def _replacing_and_failing(folder):
    """Let each writer replace files, then without room for its largest file: one that is there, one that is not."""
    prepare(folder)
    webbrowser.open = lambda address: True
    for name, writer in WRITERS.items():
        for file in writer.files:
            Path(file).write_text("old", encoding="utf-8")
        writer.write(True)
        sizes = {file: Path(file).stat().st_size for file in writer.files}
        assert b"old" not in [Path(file).read_bytes() for file in writer.files], name
        largest = max(sizes, key=lambda file: sizes[file])
        limit = sizes[largest] // 2
        too_large = [file for file in writer.files if sizes[file] > limit]
        for absent in (False, True):
            if absent:
                Path(largest).unlink()
            before = _there()
            said = _without_room(writer, limit)
            assert [file for file in too_large if Path(file).name in said], (name, said)
            after = _there()
            assert after.keys() == before.keys(), (name, after.keys() ^ before.keys())
            assert [file for file in too_large if after.get(file) != before.get(file)] == [], name
        for file in writer.files:
            Path(file).unlink(missing_ok=True)
    return len(WRITERS)


def _without_room(writer, limit):
    """Return what a writer says where files may have `limit` bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        writer.write(True)
    except OSError as error:
        return str(error)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    raise AssertionError("all was written")


def full_disk_everywhere(folder):
    """No space for the output of any command or function: figures, pages, tables, run files; new or replaced."""
    count = answer(_replacing_and_failing, folder)
    return f"{count} writers: status 5 or an OSError that names the file; nothing is left, old files remain complete"


FAULTS = (full_disk_everywhere,)
LONG = (full_disk_everywhere,)
