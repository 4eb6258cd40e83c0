"""`nontwist check`, `precision`, `compare`, `reproduce`, `validate`: whether files, numbers and the package are right.

`nontwist reproduce` and `nontwist validate`: the tables of the paper, and every check of the package.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from warnings import catch_warnings

import typer

import nontwist

from ..errors import RunFileError
from ..geometry.values import number_text
from ..io.whole import require_free, written
from ..machine import cores
from ..validation import GROUPS
from .outcomes import BAD_DATA, DIFFERS, SOLVER, CommandError, on_file
from .printing import Dataset, print_fitting, print_rows, print_table, say, say_next, say_written, show, shown_unit
from .run_commands import estimate_words, forecast_rows, read_all, read_one
from .shared_options import (
    Answer,
    Force,
    OneRunFile,
    Opt,
    Overrides,
    Quiet,
    RunFiles,
    refuse,
    require_folder,
    require_suffix,
)

if TYPE_CHECKING:
    from ..driver.single_run import Prepared
    from ..paper.tables import Table as PaperTable
    from ..validation import Check

TOLERANCE = 0.2  # of the observed order
TARGET = (
    "Instead, find the order and step that reach this error, and how long such a run takes. The order of FILE is "
    "ignored; --set integrator.order=N chooses one."
)
NOISE = 1e-12  # of the difference of two runs in the nine director components: below it no order can be seen


def check_command(files: RunFiles, overrides: Overrides = None, *, answer: Quiet) -> None:
    """Validate FILEs and preview each run without running it.

    Warns where the step is coarse. Exits with status 3 if a file is invalid.
    """
    from ..runfile.document import forecast
    from ..sweeps.members import Members

    wrong = False
    for path in files:
        member = ""
        try:
            run_file = read_one(path, overrides)
            if run_file.sweep is not None:
                Members(run_file).try_ends()
            expected = forecast(run_file)
            problems = list(expected.problems)
        except RunFileError as error:
            problems, expected = list(error.problems), None
            member = "" if error.file == str(path) else f"{error.file}: "
        for problem in problems:
            say(f"{path}: {member}{problem}", "red")
        for warning in expected.warnings if expected is not None else ():
            say(f"{path}: warning: {warning}", "yellow")
        told = [problem._asdict() for problem in problems]
        numbers = expected and {key: value for key, value in expected._asdict().items() if key != "problems"}
        is_read = answer.in_words({"file": str(path), "problems": told, "forecast": numbers})
        if is_read and expected is not None and not problems:
            print_rows(f"{path} is valid", forecast_rows(run_file, expected))
            command = "run" if run_file.sweep is None else "sweep"
            say_next((command, path), sets=overrides)
        wrong = wrong or bool(problems)
    if wrong:
        raise typer.Exit(BAD_DATA)


def precision_command(
    file: OneRunFile,
    overrides: Overrides = None,
    target: Annotated[float | None, Opt(TARGET, "RADIANS")] = None,
    *,
    answer: Quiet,
) -> None:
    """Run FILE with its step h, h/2 and h/4; print the second quotient and the observed order.

    Writes no result and looks for no events. Exits with status 1 if the observed order differs from that of the
    integrator by more than 0.2.
    """
    from ..driver.runs import dataset_of
    from ..driver.tolerance import moved

    given = list(overrides or ())
    if target is not None:
        given = _aimed(file, given, target)
    whole = read_all([file], [*given, "sweep="])[file].prepared
    prepared = whole.on_grid
    if prepared.plan.scheme.any_times:
        known = ", ".join(f'"{name}"' for name, scheme in nontwist.integrators.INTEGRATORS.items() if scheme.orders)
        name = prepared.plan.scheme.name
        raise CommandError(f'{file}: integrator.name: "{name}" -> one that steps: {known}', BAD_DATA)
    if target is not None:
        print_target(file, whole, target, given, answer)
        return
    with on_file(file):
        first = prepared.run(answer.bar)
        with catch_warnings(action="ignore"):  # of the same as the first
            finer = [prepared.refined(first, n).run(answer.bar) for n in (2, 4)]
            again = replace(prepared.refined(first, 1), begin=moved(prepared.begin)).run(answer.bar)
            other, *runs = map(dataset_of, (again, first, *finer))
    numbers = {"file": str(file), **measured(runs, other, first.integrator.order)}  # type: ignore[attr-defined]
    if answer.in_words(numbers):
        print_precision(numbers)
    if not numbers["agrees"]:
        raise typer.Exit(DIFFERS)


def _aimed(file: Path, overrides: list[str], target: float) -> list[str]:
    """Return overrides for a run to an error: without an order of the file, or another step or tolerance."""
    from ..runfile.files import document, split_override

    integrator = document(str(file), file.read_bytes()).get("integrator")
    found = ["integrator.order="] if isinstance(integrator, dict) and "order" in integrator else []
    replaced = (["time", "step"], ["time", "tolerance"])
    found += [one for one in overrides if split_override(one)[0] not in replaced]
    return [*found, f"time.tolerance={target!r}"]


def print_target(file: Path, whole: Prepared, target: float, given: list[str], answer: Answer) -> None:
    """Print the order and the step that reach an error, and the time of such a run; `given`: with these overrides."""
    from ..comparison.comparing import shortest_times
    from ..runfile.files import document

    prepared = whole.on_grid
    with on_file(file):
        found = prepared.run()
        again = whole.refined(found, 1)  # at the times of the file
        again.run()  # may compile
        seconds = shortest_times({file: again.run}, 3)[file]  # the next one links what is prepared
    order, grid, even = getattr(found.integrator, "order", None), found.segments, prepared.even_step(found)
    assert grid is not None
    assert found.error_estimate is not None
    numbers = {
        "file": str(file),
        "target": target,
        "integrator": found.integrator.name,
        "order": order,
        "steps": grid.steps,
        "step": grid.longest,
        "even_step": even,
        "error_estimate": found.error_estimate,
        "seconds": seconds,
    }
    if answer.in_words(numbers):
        span = grid.borders[-1] - grid.borders[0]
        swept = "sweep" in document(str(file), file.read_bytes())  # its members take one step
        many, chosen = "no step was found that fits the breakpoints; move them to a common grid", list[str]()
        if not swept:
            many = "time.tolerance; no step was found that fits the breakpoints"
        if even:
            chosen = [f"time.step={even:.12g}", *([f"integrator.order={order}"] if order else [])]
            many = " ".join([*(f"--set {one}" for one in chosen), f"({round(span / even)} steps)"])
        rows = {
            "integrator": found.integrator.name + (f", order {order}" if order else ""),
            "steps": f"{grid.steps} of {'at most ' * (len(grid.sizes) > 1)}{grid.longest:.12g} s",
            "error": estimate_words(found.error_estimate),
            "time taken": f"{number_text(1e3 * seconds, '.3g')} ms, storing what FILE stores",
            "for many runs": many,
        }
        print_rows(f"{file}: an error of {target:g} rad", rows)
        if swept and chosen:
            say(f"for the numbers of {file}; pass those of the most demanding member of the sweep with --set")
            say_next(("sweep", file), sets=chosen)
        elif not swept:
            say_next(("run", file), sets=given)


def measured(runs: list[Dataset], moved: Dataset, order: int) -> dict[str, Any]:
    """Return quotients and orders at five times, their median, and what they say of the error of the first run.

    That from a start that is `moved` shows round-off as in `comparison`; differences within it have no order.
    """
    import numpy as np

    from ..analysis.statistics import second_quotient
    from ..comparison.comparing import CLEAR
    from ..driver.tolerance import CHANGE
    from ..geometry.arrays import EPS

    quotient = second_quotient(*runs)
    x = [run["directors"].values.reshape(run.sizes["time"], -1)[1:] for run in (moved, *runs)]
    moves, coarse, fine = (np.linalg.norm(a - b, axis=1) for a, b in pairwise(x))
    noise = EPS / CHANGE * moves * np.sqrt(np.ptp(moved["time"].values) / runs[2].attrs["step"])
    clear = np.minimum(coarse, fine) > np.maximum(NOISE, CLEAR * noise)
    quotients = np.where(clear, quotient.values, np.nan)
    orders = np.log2(quotients)
    median = float(np.median(orders[clear])) if clear.any() else None
    at = np.unique(np.rint(np.linspace(0, len(fine), 6)).astype(int)[1:] - 1)
    return {
        "step": float(runs[0].attrs["step"]),
        "order": order,
        "observed_order": median,
        "agrees": median is None or abs(median - order) <= TOLERANCE,
        "error_at_end": float(coarse[-1] / np.sqrt(2) / (1 - 2.0**-order)),
        "times": quotient["time"].values[at].tolist(),
        "differences": fine[at].tolist(),
        "second_quotients": quotients[at].tolist(),
        "observed_orders": orders[at].tolist(),
    }


def print_precision(numbers: dict[str, Any]) -> None:
    """Print the table and the verdict."""
    columns = {
        "t (s)": [f"{t:g}" for t in numbers["times"]],
        "ξ(h/2) - ξ(h/4)": [f"{difference:.1e}" for difference in numbers["differences"]],
        "Q_II": [f"{value:.6f}".replace("nan", "–") for value in numbers["second_quotients"]],
        "observed order": [f"{value:.6f}".replace("nan", "–") for value in numbers["observed_orders"]],
    }
    title = f"{numbers['file']}: steps h = {numbers['step']:.6g} s, h/2, h/4"
    print_table(title, columns, right=tuple(columns))
    median = numbers["observed_order"]
    if median is None:
        show("no order can be observed: the runs differ by round-off only")
        show("take longer steps, or a lower order: --set integrator.order=2")
        return
    verdict = "PASS" if numbers["agrees"] else "FAIL: the step is too coarse, or the load has breakpoints off its grid"
    show(f"observed order {median:.3f} (median), expected {numbers['order']}: {verdict}")
    show(f"error of the attitude at the end with step h: about {numbers['error_at_end']:.1e} rad")


# `nontwist compare`: every integrator on the problem of a run file.


CHOSEN = Opt(
    "An integrator to compare. Repeatable.", "NAME[:ORDER]", "--integrator", default="all that can solve the problem"
)
AGAINST = Opt("What --figure draws the errors over: run times, which are overhead where runs are short, or steps.")
NUMBERS = ("attitude_error_max", "attitude_order", "momentum_error_max", "momentum_order", "twist_defect", "run_time")


def compare_command(
    file: OneRunFile,
    overrides: Overrides = None,
    integrators: Annotated[list[str] | None, CHOSEN] = None,
    steps: Annotated[
        list[float] | None,
        Opt("A step to compare. Repeatable.", "SECONDS", "--step", default="seven, from coarse to fine"),
    ] = None,
    every: Annotated[bool, Opt("Print every run, not only the summary.")] = False,
    figure: Annotated[
        Path | None, Opt("Draw the work-precision diagram to this file (.pdf, .png, .svg).", "PATH")
    ] = None,
    against: Annotated[Literal["seconds", "steps"], AGAINST] = "seconds",
    *,
    answer: Answer,
) -> None:
    """Compare integrators on the problem of FILE: errors, measured orders, drifts, run times.

    Ignores the tables [integrator] and [[event]] of FILE, and all of [time] except its span.
    """
    from ..plot.journals import require_places

    refuse((against != "seconds" and figure is None, "--against", "applies to --figure only; add --figure PATH"))
    run_file = read_one(file, overrides, alone=True)
    problem = run_file.problem.replace(times=None, events=None)
    chosen = [_choice(name) for name in integrators] if integrators else None
    if figure is not None:
        require_places(figure, force=answer.force)
    with on_file(file):
        found = nontwist.compare(problem, integrators=chosen, steps=steps, progress=answer.bar)
    is_read = answer.in_words({"file": str(file), "reference": found.attrs["reference"], "runs": _rows_of(found)})
    if is_read:
        if every:
            print_fitting(nontwist.comparison.table(found))
        print_fitting(nontwist.comparison.summary(found))
    if (found["status"] != 0).all():
        refused = bool((found["status"] < 0).all())
        raise CommandError(
            f"{file}: no integrator of this comparison solved the problem", BAD_DATA if refused else SOLVER
        )
    if is_read:
        has_steps = not nontwist.integrators.INTEGRATORS[run_file.integrator.name].any_times
        say_next(*[("precision", file)] * has_steps, ("run", file), sets=overrides)
    if figure is not None:
        nontwist.plot.save(nontwist.plot.work_precision(found, against=against), figure, force=answer.force)
        say_written([figure])


def _choice(text: str) -> str | tuple[str, int]:
    name, sign, order = text.partition(":")
    if not sign:
        return name
    refuse((not order.isdecimal(), "--integrator", f"{text!r} is not NAME:ORDER, for example gauss:8"))
    return name, int(order)


def _rows_of(found: Dataset) -> list[dict[str, Any]]:
    """Return every run as plain data."""
    rows = []
    for name in found["integrator"].values:
        group = found.sel(integrator=name)
        stepping = bool(group["takes_steps"])
        for h in group["step"].values[: None if stepping else 1]:
            run = group.sel(step=h)
            row = {"integrator": str(name), "step": float(h) if stepping else None}
            row |= {key: float(run[key]) for key in NUMBERS if key in run}
            drifts = zip(run["invariant"].values.tolist(), run["drift"].values.tolist(), strict=True)
            row |= {f"drift_{key}": value for key, value in drifts}
            rows.append({**row, "status": int(run["status"]), "message": str(run["message"].values)})
    return rows


def reproduce_command(
    case: Annotated[list[int] | None, Opt("Case 1, 2 or 3. Repeatable.", "N", default="all", least=1, most=3)] = None,
    out: Annotated[Path, Opt("Folder for tables, figures and runs.", "FOLDER")] = Path("reproduction"),
    quick: Annotated[bool, Opt("Make the tables and one figure per case only.")] = False,
    printed_loads: Annotated[
        bool, Opt("Use the loads as printed, 20 times too large, to show how the tables then differ.")
    ] = False,
    force: Force = False,
) -> None:
    """Reproduce the three cases of the paper: six tables compared with the printed ones, four figures per case.

    Prints the tables and writes everything to OUT/case1 ... case3 and, in the order of the paper, to the page
    OUT/index.html. Exits with status 1 if a number differs.
    """
    from rich.console import Console

    require_folder(out)
    with Console(stderr=True).status("starting") as status:
        result = nontwist.reproduce(
            out,
            case or (1, 2, 3),
            quick=quick,
            printed_loads=printed_loads,
            force=force,
            progress=lambda text: status.update(text),
        )
    for table in result.tables:
        _print_table(table)
    numbers = [row for table in result.tables for row in table.rows]
    agreeing = sum(row.agrees for row in numbers)
    show(f"{agreeing} of {len(numbers)} printed numbers agree; all on one page: {result.page}")
    if printed_loads:
        show("Loads as printed; the tables belong to loads 20 times smaller (docs/errata.md, 1).")
    else:
        show("Loads of cases 2 and 3: those printed over 20 (docs/errata.md, 1; see --printed-loads).")
    if not result.agrees:
        raise typer.Exit(DIFFERS)


def _print_table(table: PaperTable) -> None:
    from rich.text import Text

    rows = table.rows
    columns: dict[str, list[str] | list[Text]] = {
        "t (s)": [f"{row.time:g}" for row in rows],
        "quantity": [f"{row.quantity} ({shown_unit(row.unit)})".removesuffix(" ()") for row in rows],
        "paper": [f"{row.printed:.6f}" for row in rows],
        "computed": [f"{row.computed:.9f}" for row in rows],
        "difference": [f"{row.difference:.1e}" for row in rows],
        "verdict": [Text("agrees", "green") if row.agrees else Text("DIFFERS", "red") for row in rows],
    }
    numbers = ("t (s)", "paper", "computed", "difference")
    print_table(f"Case {table.case}: {table.title}", columns, spare=("difference", "quantity"), right=numbers)


# `nontwist validate`: every oracle of the package, measured on this machine.


def validate_command(
    group: Annotated[list[str] | None, Opt(f"One of {', '.join(GROUPS)}. Repeatable.", "NAME", default="all")] = None,
    as_json: Annotated[bool, Opt("Print JSON with every digit instead of tables.", option="--json")] = False,
    page: Annotated[
        Path | None, Opt("Write a summary to this file (.md), and all checks beside it (.json).", "PATH")
    ] = None,
    force: Force = False,
) -> None:
    """Check this installation against printed digits, closed forms, invariants and independent solutions.

    Prints tables. Exits with status 1 if a check fails. All groups take about a minute, longer on the first run.
    """
    from rich.console import Console

    refuse(*((name not in GROUPS, "--group", f"{name!r} is not one of {', '.join(GROUPS)}") for name in group or ()))
    if page is not None:
        require_suffix(page, ".md", option="--page")
        files = page, page.with_suffix(".json")
        for file in files:
            require_free(file, force=force)
    errors = Console(stderr=True)
    with errors.status("starting") as status:
        result = nontwist.validate(group or None, workers=min(2, cores()), progress=status.update)
    if page is not None:
        for file, text in zip(files, (result.to_markdown(files[1].name), result.to_json() + "\n"), strict=True):
            with written(file, force=force) as stream:
                stream.write(text.encode())
        say_written(files)
    if as_json:
        typer.echo(result.to_json())
    else:
        for name, checks in result.groups.items():
            _print_checks(name, checks)
        show(result.summary)
    for note in result.notes:
        say(note)
    if not result.holds:
        raise typer.Exit(DIFFERS)


def _print_checks(group: str, checks: tuple[Check, ...]) -> None:
    from rich.text import Text

    from ..validation.checks import numbers

    sources = list(dict.fromkeys(check.source for check in checks))
    expected, measured, tolerance = zip(*map(numbers, checks), strict=True)
    columns = {
        "check": [check.name for check in checks],
        "expected": expected,
        "measured": measured,
        "tolerance": tolerance,
        "verdict": [Text("PASS", "green") if check.holds else Text("FAIL", "bold red") for check in checks],
        "source": [f"[{sources.index(check.source) + 1}]" for check in checks],
    }
    print_table(group, columns, spare=("source",), right=("expected", "measured", "tolerance", "source"))
    for k, source in enumerate(sources):
        show(f"[{k + 1}] {source}")
    show("")
