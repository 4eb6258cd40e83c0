"""What the commands on run files print: tables for people, plain data for programs."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from ..geometry.values import number_text
from .outcomes import for_terminals, say, stdout

if TYPE_CHECKING:
    import xarray
    from rich.table import Table
    from rich.text import Text

    from ..driver.single_run import Forecast
    from ..runfile import RunFile

ROUND_OFF = 2e-15  # rad: a truncation error below it is lost in the round-off of the attitudes
MOST_TIMES = 5  # of an event, in a table
imported: list[str] = []  # the modules that the running command has imported with --import
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def print_json(data: dict[str, Any]) -> None:
    """Print an object on one line; numbers that are not finite are null."""
    from ..io.results import finite

    print(json.dumps(finite(data), allow_nan=False))


def in_words(numbers: dict[str, Any], as_json: bool, quiet: bool = False) -> bool:
    """Print what a command has found, if it was asked for, as JSON; return whether people are to read it."""
    if as_json:
        print_json(numbers)
    return not (as_json or quiet)


def say_written(places: Iterable[object], *commands: str) -> None:
    """Say which files were written, and what may be typed next."""
    say(f"written: {', '.join(map(str, places))}" + (f"; {hint(*commands)}" if commands else ""))


def print_variables(variables: Mapping[str, Mapping[str, Any]], spare: tuple[str, ...], **more: list[str]) -> None:
    """Print names, units and meanings of variables, and further columns of words before the meanings."""
    about = variables.values()
    columns = {"name": [*variables], "unit": [shown_unit(one["units"]) for one in about]}
    print_table("variables", columns | more | {"meaning": [one["long_name"] for one in about]}, spare=spare)


def print_rows(title: str, rows: dict[str, str]) -> None:
    """Print a title and two columns."""
    print_table(title, {"": list(rows), " ": list(rows.values())})


def print_table(
    title: str, columns: Mapping[str, Sequence[str | Text]], spare: tuple[str, ...] = (), right: tuple[str, ...] = ()
) -> None:
    """Print columns by their headings, without a line of headings where they are blank.

    No word is cut: lines are broken between words, and where there is no room the columns `spare` are left out, the
    first one first. Only a word that is wider than the terminal is broken, in the last column.

    Parameters
    ----------
    title : str
    columns : mapping from str to sequence of str or Text
    spare : tuple of str, optional
        Headings of columns that may be left out.
    right : tuple of str, optional
        Headings of columns that are aligned on the right.
    """
    from rich.table import Table
    from rich.text import Text

    console = stdout()
    kept = {
        heading: [cell if isinstance(cell, Text) else Text(for_terminals(cell)) for cell in cells]
        for heading, cells in columns.items()
    }
    spared = list(spare)
    while (widths := widths_within(kept, console.width - 3 * len(kept) - 1, folded=not spared)) is None and spared:
        del kept[spared.pop(0)]
    headed = any(heading.strip() for heading in kept)
    table = Table(show_header=headed)
    for heading, width in zip(kept, widths or [8] * len(kept), strict=True):
        justify: Literal["left", "right"] = "right" if heading in right else "left"
        table.add_column(heading, width=width, justify=justify, overflow="fold")
    for row in zip(*kept.values(), strict=True):
        table.add_row(*row)
    console.print(Text(title, style="table.title"))  # as wide as the terminal, not as the table
    console.print(table)


def print_fitting(table: Table) -> None:
    """Print a table of numbers; where the terminal is too narrow its last columns are left out, drifts first."""
    from rich.measure import Measurement

    console, dropped = stdout(), []
    while Measurement.get(console, console.options.update(width=10**4), table).maximum > console.width:
        columns = table.columns[2:]
        if not columns:
            break
        drifts = [one for one in columns if str(one.header).startswith(("drift", "twist"))]
        one = (drifts or columns)[-1]
        dropped.append(" ".join(str(one.header).split()))
        table.columns.remove(one)
        for k, column in enumerate(table.columns):
            column._index = k
    console.print(table)
    if dropped:
        say(f"a wider terminal shows {len(dropped)} more columns: {', '.join(reversed(dropped))}")


def widths_within(columns: Mapping[str, Sequence[str | Text]], room: int, folded: bool = False) -> list[int] | None:
    """Return widths of columns that fill `room` at most and cut no word, None where there are none.

    With `folded` words of the last column may be cut.
    """
    from rich.cells import cell_len

    texts = [[heading, *map(str, cells)] for heading, cells in columns.items()]
    least = [max((cell_len(word) for text in column for word in text.split()), default=0) for column in texts]
    widths = [max(cell_len(line) for text in column for line in (text.splitlines() or [""])) for column in texts]
    if folded:
        least = [*least[:-1], 1]
    while sum(widths) > room:
        loose = [k for k, width in enumerate(widths) if width > least[k]]
        if not loose:
            return None
        widths[max(loose, key=lambda k: widths[k])] -= 1
    return widths


def shown_unit(unit: str) -> str:
    """Return a unit of a dataset as people write it: ``kg m² s⁻¹`` for ``kg m2 s-1``, rad/s for ``rad s-1``."""
    if unit in ("1", "degree"):
        return {"1": "", "degree": "°"}[unit]
    raised = re.sub(r"(?<=[A-Za-z])-?\d+", lambda power: power[0].translate(RAISED), unit)
    return raised.replace("rad s⁻¹", "rad/s")


def scheme_words(scheme: Mapping[str, Any]) -> str:
    """Return an integrator in words: its name, its order, and its options that are not the usual ones."""
    from dataclasses import fields

    from ..integrators import INTEGRATORS

    known = fields(INTEGRATORS[scheme["name"]]) if scheme["name"] in INTEGRATORS else ()
    usual = {field.name: field.default for field in known if field.name != "order"}
    own = [f"{name} {value}" for name, value in scheme.items() if name != "name" and usual.get(name) != value]
    return ", ".join([scheme["name"], *own])


def set_again(overrides: Sequence[str] | None) -> list[str]:
    """Return the options --set of a command, to be typed again."""
    return [word for override in overrides or () for word in ("--set", shlex.quote(override))]


def typed(path: object) -> str:
    """Return a path as it is typed in a command: in quotes where it has blanks."""
    return shlex.quote(str(path))


def hint(*commands: str) -> str:
    """Return what may be typed next, with the modules that this command imports."""
    modules = "".join(f" --import {module}" for module in imported)
    return f"next: {', '.join(command + modules for command in commands)}"


def _body_words(run_file: RunFile) -> str:
    """Return kind, principal moments and weight of a body."""
    import numpy as np

    from ..geometry.values import vector_text

    moments = np.linalg.eigvalsh(run_file.problem.system.convected_inertia)
    weight = run_file.body.weight(run_file._folder)
    heavy = "" if weight is None else f"; {weight[0]:.4g} kg, centre of mass {vector_text(weight[1])} m"
    return f"{run_file.body.kind}, principal moments {', '.join(f'{J:.4g}' for J in moments)} kg m²{heavy}"


def forecast_rows(run_file: RunFile, forecast: Forecast) -> dict[str, str]:
    """Return what a run will be like, in words."""
    from dataclasses import asdict

    from ..driver.notices import amount, duration

    scheme = run_file.prepared.scheme
    rows = {
        "body": _body_words(run_file),
        "loads": ", ".join(forecast.loads) or "none",
        "integrator": scheme_words({"name": scheme.name, **asdict(scheme)}),
    }
    span = f"t = {run_file.time.t_start:g} s to {run_file.time.t_end:g} s"
    automatic = " (automatic)" if run_file.time.step is None else ""
    if scheme.any_times:
        rows["output"] = f"{forecast.states} states, {span}, every {forecast.step:.6g} s{automatic}"
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


def steps_of(run: xarray.Dataset) -> int:
    """Return how many steps a run has taken."""
    from ..analysis.trajectory import stretches_from
    from ..integrators.problem import FIT

    time, grid = run["time"].values, stretches_from(run.attrs.get("stretches"))
    span = float(time[-1] - time[0])
    return math.ceil(span / run.attrs["step"] * (1 - FIT)) if grid is None else grid.steps_until(float(time[-1]))


def run_numbers(run: xarray.Dataset) -> dict[str, Any]:
    """Return what was done in a run and how well its invariants were kept, as plain data."""
    from ..analysis.trajectory import stretches_from

    time, iterations = run["time"].values, run.get("newton_iterations")
    grid = stretches_from(run.attrs.get("stretches"))
    numbers: dict[str, Any] = {
        "title": run.attrs["title"],
        "status": int(run.attrs["status"]),
        "message": run.attrs["message"],
        "integrator": json.loads(run.attrs["integrator"]),
        "steps": steps_of(run),
        "step": float(run.attrs["step"]),
        "t_start": float(time[0]),
        "t_end": float(time[-1]),
        "states": len(time),
        "newton_iterations": int(iterations.values.max()) if iterations is not None and iterations.size else None,
    }
    if grid is not None:
        numbers["stretches"] = len(grid.sizes)
    numbers |= {name: float(run.attrs[name]) for name in ("tolerance", "error_estimate") if "tolerance" in run.attrs}
    if "warning" in run.attrs:
        numbers["warning"] = run.attrs["warning"]
    if "t_events" in run:
        numbers["events"] = times_of_events(run)
    return numbers | invariants_kept(run)


def invariants_kept(run: xarray.Dataset) -> dict[str, Any]:
    """Return the drifts of the invariants of a run, and its defect of the twist where its body may not twist."""
    from ..analysis.invariants import drifts, twist_defect

    defect = twist_defect(run)
    found = {"drift": {name: drift._asdict() for name, drift in drifts(run).items()}}
    return found | ({} if defect is None else {"twist_defect": defect})


def times_of_events(run: xarray.Dataset) -> dict[str, list[float]]:
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
        rows["steps"] = f"{numbers['steps']} of {'at most ' * ('stretches' in numbers)}{numbers['step']:.6g} s"
    if "tolerance" in numbers:
        rows["error"] = f"{estimate_words(numbers['error_estimate'])}, tolerance {numbers['tolerance']:g}"
    for name, drift in numbers.get("drift", {}).items():
        relative, absolute = (number_text(drift[kind], ".1e") for kind in ("relative", "absolute"))
        sized = f"{relative} relative, {absolute} {shown_unit(drift['units'])} ({drift['symbol']})"
        rows[f"drift of {in_words(name)}"] = absolute if drift["units"] == "1" else sized
    if "twist_defect" in numbers:
        rows["largest twist rate about the axis"] = f"{number_text(numbers['twist_defect'], '.1e')} rad/s"
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
    return rows | {"time taken": f"{number_text(numbers['seconds'], '.3g')} s, with start-up"}
