"""`nontwist run`: run files to results."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from importlib.resources import files
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import RunFileError, SimulationError, SimulationInterrupt
from .options import Force, Json, Opt, Overrides, Quiet, RunFiles, argument, refuse, require_folder, require_suffix
from .outcomes import BAD_DATA, INTERRUPTED, IO, SOLVER, CommandError, about, printed_warnings, say, smooth
from .summaries import hint, in_words, print_rows, run_numbers, run_rows, say_written, typed

if TYPE_CHECKING:
    import xarray

    from ..runfile import RunFile

RESULTS = Opt("Result file (.nc), or folder for results.", "PATH", default="output.path of FILE, else NAME.nc here")
COPY = Opt("File (.toml) or folder to copy to; - for standard output.", "PATH", default="NAME.toml here")
FIGURES = ("momenta", "energy", "path")


def run_command(
    files: RunFiles,
    overrides: Overrides = None,
    out: Annotated[Path | None, RESULTS] = None,
    figures: Annotated[bool, Opt("Draw momenta, energy and path next to the result.")] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run FILEs: write each result (NetCDF) and its figures, and print a summary.

    All files are checked before the first one runs. If the solver fails, the completed part is saved, the other files
    still run, and the command exits with status 4. Ctrl-C, SIGTERM and a closed terminal (SIGHUP) save the completed
    part, too.
    """
    from ..driver.notices import sigterm_interrupts
    from ..io.results import reserved
    from ..io.whole import require_free

    run_files = read_all(files, overrides)
    targets = {path: _target(path, one, out, len(files)) for path, one in run_files.items()}
    drawn: dict[Path, tuple[str, ...]] = {
        path: FIGURES if figures else tuple(one.output.figures) for path, one in run_files.items()
    }
    _require_names(targets)
    figure_files = [place for path in files for name in drawn[path] for place in _figure_files(targets[path], name)]
    require_free(*figure_files, force=force)
    complete = True
    with ExitStack() as held, sigterm_interrupts():
        writes = {path: held.enter_context(reserved(target, force=force)) for path, target in targets.items()}
        for path, run_file in run_files.items():
            how: dict[str, Any] = {"figures": drawn[path], "force": force, "as_json": as_json, "quiet": quiet}
            complete &= _run(run_file, path, targets[path], writes[path], **how)
    if not complete:
        raise typer.Exit(SOLVER)


def read_all(files: list[Path], overrides: list[str] | None) -> dict[Path, RunFile]:
    """Read run files; all problems of all of them are reported in one error."""
    run_files, problems = {}, []
    for path in files:
        try:
            run_files[path] = read_one(path, overrides)
        except RunFileError as error:
            problems.append(str(error))
    if problems:
        raise CommandError("\n".join(problems), BAD_DATA)
    return run_files


def read_one(path: Path, overrides: list[str] | None) -> RunFile:
    """Read a run file; where there is none of this name, say which one may be meant."""
    from ..runfile import read_run_file

    try:
        return read_run_file(path, overrides or ())
    except FileNotFoundError as error:
        hint = ""
        if path.with_name(f"{path.name}.toml").is_file():
            hint = f"; did you mean {path}.toml?"
        elif path.suffix == ".nc":
            hint = f"; did you mean {path.with_suffix('.toml')}? results are written by nontwist run, from run files"
        elif path.suffix in ("", ".toml") and path.stem in example_names():
            hint = f"; nontwist example {path.stem} copies it here"
        raise CommandError(f"{path}: {error.strerror}{hint}", IO) from error


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


def _require_names(targets: dict[Path, Path]) -> None:
    """Refuse two results of one name."""
    owner: dict[Path, Path] = {}
    for path, target in targets.items():
        other = owner.setdefault(target.absolute(), path)
        if other != path:
            message = f"{other} and {path} would both write {target}; give each an output.path of its own"
            raise CommandError(message, IO)


def _run(
    run_file: RunFile,
    path: Path,
    target: Path,
    write: Callable[[xarray.Dataset], None],
    *,
    figures: tuple[str, ...],
    force: bool,
    as_json: bool,
    quiet: bool,
) -> bool:
    """Run one file, write the result, print a summary; return whether the run was completed."""
    from ..driver.runs import simulate

    if run_file.sweep is not None:
        say(f"{path}: warning: the table [sweep] is ignored; nontwist sweep {path} runs all members", "yellow")
    started, stopped = perf_counter(), None
    with about(str(path), ValueError), printed_warnings(path):
        try:
            run = simulate(run_file.problem, progress=not quiet and sys.stderr.isatty())
        except (SimulationError, SimulationInterrupt) as error:
            stopped, run = error, error.partial.to_dataset().assign_attrs(run_file.record())
    seconds = perf_counter() - started
    with about(f"cannot write {target}", OSError):
        write(run)
    written = [target]
    if stopped is None:
        drawn = run
        if figures:
            with suppress(ValueError, SimulationError):  # a load that ends here, or a step that fails
                drawn = smooth(run, run_file.prepared.plan.load)
        written += [figure for name in figures for figure in _draw(drawn, target, name, force)]
    else:
        say(f"{path}: {stopped}", "red")
        say(f"{path}: the completed part, up to t = {float(run['time'][-1]):.12g} s, is saved in {target}", "red")
    numbers = {"file": str(path), "result": str(target), **run_numbers(run), "seconds": seconds}
    if in_words(numbers | {"written": [*map(str, written)]}, as_json, quiet):
        print_rows(numbers["title"], run_rows(numbers))
    if not quiet:
        result = typed(target)
        say_written(written, f"nontwist view {result}", f"nontwist info {result}")
    if isinstance(stopped, KeyboardInterrupt):
        raise typer.Exit(INTERRUPTED)
    return stopped is None


def _figure_files(target: Path, name: str) -> list[Path]:
    return [target.with_name(f"{target.stem}-{name}{suffix}") for suffix in (".pdf", ".png")]


def _draw(run: xarray.Dataset, target: Path, name: str, force: bool) -> list[Path]:
    from .. import plot

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


def example_names() -> list[str]:
    """Return the names of the run files that come with the package."""
    folder = files("nontwist.runfile").joinpath("examples")
    return sorted(place.name.removesuffix(".toml") for place in folder.iterdir() if place.name.endswith(".toml"))


def example_command(
    name: Annotated[
        str | None, argument("NAME", "Example to copy.", show_default="list all", autocompletion=example_names)
    ] = None,
    out: Annotated[Path | None, COPY] = None,
    force: Force = False,
) -> None:
    """List the bundled run files, or copy one to start from."""
    from ..geometry.values import nearest
    from ..io.whole import written

    texts = {name: _text(name) for name in example_names()}
    if name is None:
        return _list(texts)
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
    say_written([target], f"nontwist check {typed(target)}", f"nontwist {command} {typed(target)}")
    return None


def schema_command() -> None:
    """Print the JSON Schema of run files, for editors that complete and validate them."""
    from ..runfile.document import json_schema

    typer.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def _text(name: str) -> str:
    return files("nontwist.runfile").joinpath("examples", f"{name}.toml").read_text(encoding="utf-8")


def _list(texts: dict[str, str]) -> None:
    print_rows("Examples", {name: text.splitlines()[0].removeprefix("# ") for name, text in texts.items()})
    say(hint("nontwist example NAME"))
