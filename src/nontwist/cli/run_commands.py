"""`nontwist run`, `example` and `schema`: run files, to begin with and to results."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

import nontwist

from ..errors import RunFileError, SimulationError, SimulationInterrupt
from ..geometry.values import nearest, number_text
from ..io.whole import require_free, written
from .outcomes import BAD_DATA, INTERRUPTED, IO, SOLVER, CommandError, about, on_file
from .printing import Dataset, print_rows, say, say_next, say_written, shown_unit
from .shared_options import Answer, Force, Opt, Overrides, RunFiles, argument, refuse, require_folder, require_suffix
from .view_commands import smooth

if TYPE_CHECKING:
    from ..driver.single_run import Forecast
    from ..runfile import RunFile

RESULTS = Opt("Result file (.nc), or folder for results.", "PATH", default="output.path of FILE, else NAME.nc here")
COPY = Opt("File (.toml) or folder to copy to; - for standard output.", "PATH", default="NAME.toml here")
ROUND_OFF = 2e-15  # rad: a truncation error below it is lost in the round-off of the attitudes
MOST_TIMES = 5  # of an event, in a table
TOLD = ("title", "status", "message", "integrator", "step", "tolerance", "error_estimate", "warning")
FIGURES = ("momenta", "energy", "path")


def run_command(
    files: RunFiles,
    overrides: Overrides = None,
    out: Annotated[Path | None, RESULTS] = None,
    figures: Annotated[bool, Opt("Draw momenta, energy and path next to the result.")] = False,
    *,
    answer: Answer,
) -> None:
    """Run FILEs: write each result (NetCDF) and its figures, and print a summary.

    All files are checked before the first one runs. If the solver fails, the completed part is saved, the other files
    still run, and the command exits with status 4. Ctrl-C, SIGTERM and a closed terminal (SIGHUP) save the completed
    part, too.
    """
    from ..driver.notices import sigterm_interrupts
    from ..io.run_files import reserved

    run_files = read_all(files, overrides, alone=True)
    targets = {path: _target(path, one, out, len(files)) for path, one in run_files.items()}
    drawn: dict[Path, Any] = {path: FIGURES if figures else one.output.figures for path, one in run_files.items()}
    for one, other in combinations(targets, 2):
        if targets[one].absolute() == targets[other].absolute():
            message = f"{one} and {other} would both write {targets[other]}; give each an output.path of its own"
            raise CommandError(message, IO)
    figure_files = [place for path in files for name in drawn[path] for place in _figure_files(targets[path], name)]
    require_free(*figure_files, force=answer.force)
    complete = True
    with ExitStack() as held, sigterm_interrupts():
        writes = {path: held.enter_context(reserved(target, force=answer.force)) for path, target in targets.items()}
        for path, run_file in run_files.items():
            complete &= _run(run_file, path, targets[path], writes[path], drawn[path], answer)
    if not complete:
        raise typer.Exit(SOLVER)


def read_all(files: list[Path], overrides: list[str] | None, alone: bool = False) -> dict[Path, RunFile]:
    """Read run files; all problems of all of them are reported in one error."""
    run_files, problems = {}, []
    for path in files:
        try:
            run_files[path] = read_one(path, overrides, alone)
        except RunFileError as error:
            problems.append(str(error))
    if problems:
        raise CommandError("\n".join(problems), BAD_DATA)
    return run_files


def read_one(path: Path, overrides: list[str] | None, alone: bool = False) -> RunFile:
    """Read a run file; where there is none of this name, say which one may be meant.

    One that is run `alone`, without its sweep, needs no step for all members.
    """
    from ..runfile import read_run_file

    given = list(overrides or ())
    try:
        try:
            return read_run_file(path, given)
        except RunFileError as error:
            if not alone or [problem.key for problem in error.problems] != ["time.step"]:
                raise
            run_file = read_run_file(path, [*given, "sweep="])
            _warn_of_sweep(path)
            return run_file
    except FileNotFoundError as error:
        hint = ""
        if path.with_name(f"{path.name}.toml").is_file():
            hint = f"; did you mean {path}.toml?"
        elif path.suffix == ".nc":
            near = f"did you mean {own}? " if (own := path.with_suffix(".toml")).is_file() else ""
            hint = f"; {near}results are written by nontwist run, from run files"
        elif path.suffix in ("", ".toml") and path.stem in example_names():
            hint = f"; nontwist example {path.stem} copies it here"
        raise CommandError(f"{path}: {error.strerror}{hint}", IO) from error


def _warn_of_sweep(path: Path) -> None:
    say(f"{path}: warning: the table [sweep] is ignored; nontwist sweep {path} runs all members", "yellow")


def _target(path: Path, run_file: RunFile, out: Path | None, files: int) -> Path:
    name = f"{path.stem}.nc"
    if out is None:
        return Path(name) if run_file.output.path is None else run_file.folder / run_file.output.path
    if out.suffix != ".nc":
        require_folder(out, instead="; results are NetCDF, NAME.nc, and nontwist export writes CSV, NPZ and JSON")
        out.mkdir(parents=True, exist_ok=True)
        return out / name
    refuse((files > 1, "--out", f"{out} is one file for {files} results; name a folder"))
    return out


def _run(run_file: RunFile, path: Path, target: Path, write: Any, figures: Sequence[str], answer: Answer) -> bool:
    """Run one file, write the result, print a summary; return whether the run was completed."""
    if run_file.sweep is not None:
        _warn_of_sweep(path)
    started, stopped = perf_counter(), None
    with on_file(path):
        try:
            run = nontwist.simulate(run_file.problem, progress=answer.bar)
        except (SimulationError, SimulationInterrupt) as error:
            stopped, run = error, error.partial.to_dataset().assign_attrs(run_file.record())
    seconds = perf_counter() - started
    with about(f"cannot write {target}", OSError):
        write(run)
    written, numbers = [target], {"file": str(path), "result": str(target), **run_numbers(run), "seconds": seconds}
    if stopped is None and figures:
        started, drawn = perf_counter(), run
        with suppress(ValueError, SimulationError):  # a load that ends here, or a step that fails
            drawn = smooth(run, run_file.prepared.plan.load)
        written += [figure for name in figures for figure in _draw(drawn, target, name, answer.force)]
        numbers["figure_seconds"] = perf_counter() - started
    elif stopped is not None:
        say(f"{path}: {stopped}", "red")
        say(f"{path}: the completed part, up to t = {float(run['time'][-1]):.12g} s, is saved in {target}", "red")
    if answer.in_words(numbers | {"written": [*map(str, written)]}):
        print_rows(numbers["title"], run_rows(numbers))
    moves = [("view", target)] if run.sizes["time"] > 1 else []
    answer.written(written, *moves, ("info", target))
    if isinstance(stopped, KeyboardInterrupt):
        raise typer.Exit(INTERRUPTED)
    return stopped is None


def _figure_files(target: Path, name: str) -> list[Path]:
    return [target.with_name(f"{target.stem}-{name}{suffix}") for suffix in (".pdf", ".png")]


def _draw(run: Dataset, target: Path, name: str, force: bool) -> list[Path]:
    plot = nontwist.plot
    if name == "momenta":
        left, right = plot.new_axes(columns=2, panels=2)
        plot.momenta(run, left, frame="space")
        drawn = plot.momenta(run, right, frame="body")
    else:
        drawn = {"energy": plot.energy, "path": plot.path}[name](run)
    places = _figure_files(target, name)
    plot.save(drawn, *places, force=force)
    return places


# `nontwist example` and `nontwist schema`: how a run file is written.


def examples() -> dict[str, str]:
    """Return the run files that come with the package, by their names."""
    folder: Any = files("nontwist.runfile").joinpath("examples")
    places = sorted(folder.glob("*.toml"))
    return {place.stem: place.read_text(encoding="utf-8") for place in places}


def example_names() -> list[str]:
    """Return the names of the run files that come with the package."""
    return [*examples()]


def example_command(
    name: Annotated[
        str | None, argument("NAME", "Example to copy.", show_default="list all", autocompletion=example_names)
    ] = None,
    out: Annotated[Path | None, COPY] = None,
    force: Force = False,
) -> None:
    """List the bundled run files, or copy one to start from."""
    texts = examples()
    if name is None:
        print_rows("Examples", {name: text.splitlines()[0].removeprefix("# ") for name, text in texts.items()})
        return say_next(("example", "NAME"))
    if name not in texts:
        raise typer.BadParameter(f"there is no example {name!r}; {nearest(name, texts)}")
    if out is not None and str(out) == "-":
        typer.echo(texts[name], nl=False)
        return None
    target = Path(f"{name}.toml") if out is None else out / f"{name}.toml" if out.is_dir() else out
    require_suffix(target, ".toml")
    with written(target, force=force) as file:
        file.write(texts[name].encode())
    command = "sweep" if "[sweep]" in texts[name] else "run"
    say_written([target], ("check", target), (command, target))
    return None


def schema_command() -> None:
    """Print the JSON Schema of run files, for editors that complete and validate them."""
    from ..runfile.document import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


# What is said of a run, before it and after it.


def scheme_words(scheme: Mapping[str, Any]) -> str:
    """Return an integrator in words: its name, its order, and its options that are not the usual ones."""
    from dataclasses import fields

    kind: Any = nontwist.integrators.INTEGRATORS.get(scheme["name"])
    known = () if kind is None else fields(kind)
    usual = {field.name: field.default for field in known if field.name != "order"}
    own = [f"{name} {value}" for name, value in scheme.items() if name != "name" and usual.get(name) != value]
    return ", ".join([scheme["name"], *own])


def body_rows(system: Any, weight: tuple[float, Any] | None) -> dict[str, str]:
    """Return a body in words; `weight`: its mass and centre of mass, where these are known."""
    import numpy as np

    rows = {"body": f"{system.name}; principal moments {_vector(np.linalg.eigvalsh(system.convected_inertia))} kg m²"}
    if system.axis is not None:
        rows["body"] += f"; {'no twist' if system.spin is None else 'a prescribed spin'} about {_vector(system.axis)}"
    if system.dead_force.any():
        forces = enumerate(system.dead_force, 1)
        rows["dead forces"] = "; ".join(f"d{k}: {_vector(force)} N m" for k, force in forces if force.any())
    if weight is not None:
        rows["mass"] = f"{weight[0]:.6g} kg, with its centre at {_vector(weight[1])} m"
    return rows


def _vector(values: Any) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"


def forecast_rows(run_file: RunFile, forecast: Forecast) -> dict[str, str]:
    """Return what a run will be like, in words."""
    from dataclasses import asdict

    from ..driver.notices import amount, duration

    scheme = run_file.prepared.scheme
    rows = body_rows(run_file.problem.system, run_file.body.weight(run_file._folder))
    rows["loads"] = ", ".join(forecast.loads) or "none"
    rows["integrator"] = scheme_words({"name": scheme.name, **asdict(scheme)})
    span = f"t = {run_file.time.t_start:g} s to {run_file.time.t_end:g} s"
    automatic = " (automatic)" if run_file.time.step is None else ""
    if scheme.any_times:
        every = "" if run_file.prepared.plan.off_grid else f", every {forecast.step:.6g} s{automatic}"
        rows["output"] = f"{forecast.states} states, {span}{every}"
    else:
        most = "at most " * (len(run_file.prepared.grid.sizes) > 1)
        rows["steps"] = f"{forecast.steps} of {most}{forecast.step:.6g} s{automatic}, {span}"
        rows["turn per step"] = f"at most {forecast.turn:.3g}°"
    if run_file.prepared.plan.is_controlled:
        rows["tolerance"] = f"{run_file.prepared.plan.goal:g} rad; order and steps are a first estimate, often too high"
    elif forecast.phase_error is not None:
        rows["phase error"] = f"about {forecast.phase_error:.1g}° at the end, for a steady rotation at this speed"
    rows["result"] = f"{forecast.states} states, about {amount(forecast.size)} of memory"
    rows["time"] = f"about {duration(forecast.seconds)}, without start-up"
    if run_file.sweep is not None:
        keys = ", ".join(one.key for one in run_file.sweep.over)
        time = f"about {duration(forecast.sweep_seconds or 0.0)} on one core"
        rows["sweep"] = f"{run_file.sweep.members} members over {keys}, {time}; nontwist sweep --dry-run gives details"
    return rows


def steps_of(run: Dataset) -> dict[str, int]:
    """Return how many steps a run has taken, as {"steps": N}; nothing of a run without steps or states."""
    from ..analysis.trajectory import segments_from
    from ..integrators.ivp import FIT

    time, grid, h = run["time"].values, segments_from(run.attrs.get("segments")), run.attrs.get("step")
    if h is None or not len(time):
        return {}
    span = float(time[-1] - time[0])
    return {"steps": math.ceil(span / h * (1 - FIT)) if grid is None else grid.steps_until(float(time[-1]))}


def run_numbers(run: Dataset) -> dict[str, Any]:
    """Return what was done in a run and how well its invariants were kept, as plain data."""
    from ..analysis.trajectory import segments_from
    from ..io.run_files import record

    time, iterations = run["time"].values, run.get("newton_iterations")
    numbers = {name: value for name, value in record(run).items() if name in TOLD}
    numbers |= {**steps_of(run), "t_start": float(time[0]), "t_end": float(time[-1]), "states": len(time)}
    numbers["newton_iterations"] = None if iterations is None or not iterations.size else int(iterations.values.max())
    if (grid := segments_from(run.attrs.get("segments"))) is not None:
        numbers["segments"] = len(grid.sizes)
    if "t_events" in run:
        numbers["events"] = times_of_events(run)
    return numbers | invariants_kept(run)


def invariants_kept(run: Dataset) -> dict[str, Any]:
    """Return the drifts of the invariants of a run, and its defect of the twist where its body may not twist."""
    from ..analysis.invariants import drifts, twist_defect

    defect = twist_defect(run)
    found = {"drift": {name: drift._asdict() for name, drift in drifts(run).items()}}
    return found | ({} if defect is None else {"twist_defect": defect})


def times_of_events(run: Dataset) -> dict[str, list[float]]:
    """Return the times of the events of a run, s, by their names, of those that did not happen none."""
    names, times = run["event_name"].values.tolist(), run["t_events"].values.tolist()
    asked = dict.fromkeys([*json.loads(run.attrs.get("events", "[]")), *names])
    return {one: [t for t, name in zip(times, names, strict=True) if name == one] for one in asked}


def estimate_words(error: float) -> str:
    """Return the estimate of a truncation error in words; one below round-off is not given as a number."""
    return f"estimated as {number_text(error, '.1e')} rad" if error > ROUND_OFF else "below round-off"


def rows_of_run(
    numbers: Mapping[str, Any], events: Mapping[str, list[float]], most: int | None = None
) -> dict[str, str]:
    """Return in words what is known of how a run was made and how right it is; of events so many times at most."""
    from ..analysis.invariants import in_words

    rows = {}
    if "integrator" in numbers:
        rows["integrator"] = scheme_words(numbers["integrator"])
    if "steps" in numbers:
        rows["steps"] = f"{numbers['steps']} of {'at most ' * ('segments' in numbers)}{numbers['step']:.6g} s"
    if "tolerance" in numbers:
        rows["error"] = f"{estimate_words(numbers['error_estimate'])}, tolerance {numbers['tolerance']:g}"
    for name, drift in numbers.get("drift", {}).items():
        relative, absolute = (number_text(drift[kind], ".1e") for kind in ("relative", "absolute"))
        sized = f"{relative} relative, {absolute} {shown_unit(drift['units'])} ({drift['symbol']})"
        rows[f"drift of {in_words(name)}"] = absolute if drift["units"] == "1" else sized
    if "twist_defect" in numbers:
        rows["largest error of the twist rate"] = f"{number_text(numbers['twist_defect'], '.1e')} rad/s"
    for name, times in events.items():
        more = f", ... ({len(times)}; nontwist info lists all)" if most is not None and len(times) > most else ""
        rows[f"event {name}"] = f"t = {', '.join(f'{t:.9g}' for t in times[:most])} s{more}" if times else "none"
    return rows


def run_rows(numbers: Mapping[str, Any]) -> dict[str, str]:
    """Return the numbers of a run that has just been made in words."""
    rows = rows_of_run(numbers, numbers.get("events", {}), MOST_TIMES)
    rows["time"] = f"{numbers['t_start']:g} s to {numbers['t_end']:g} s"
    rows["states"] = str(numbers["states"])
    if "warning" in numbers:
        rows["warning"] = numbers["warning"]
    if numbers["newton_iterations"]:
        rows["Newton iterations"] = f"at most {numbers['newton_iterations']} per step"
    if numbers["status"] == 0 and numbers["message"] != "done":
        rows["end"] = numbers["message"]
    drawn = (
        f", and {number_text(numbers['figure_seconds'], '.3g')} s for figures" if "figure_seconds" in numbers else ""
    )
    return rows | {"time taken": f"{number_text(numbers['seconds'], '.3g')} s, with start-up{drawn}"}
