"""`nontwist check` and `nontwist precision`: whether the file is right, and how right its numbers are."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from .options import Debug, Json, OneRunFile, Overrides, Quiet, RunFiles
from .outcomes import BAD_DATA, DIFFERS, CommandError, about, say, stdout
from .run_commands import printed_warnings, read_all, read_one
from .summaries import forecast_rows, print_json, print_rows

if TYPE_CHECKING:
    import xarray

TOLERANCE = 0.2  # of the observed order
NOISE = 1e-12  # of the difference of two runs in the nine director components: below it no order can be seen


def check_command(
    files: RunFiles,
    overrides: Overrides = None,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Say all that is wrong with FILEs, and what each run will be like; run nothing.

    Warns when the step is coarse. Exit code 3 when something is wrong.
    """
    from ..runfile import RunFileError
    from ..runfile.forecast import forecast

    wrong = False
    for path in files:
        found: dict[str, Any] = {"file": str(path), "problems": [], "forecast": None}
        try:
            run_file = read_one(path, overrides)
            expected = forecast(run_file)
            problems = list(expected.problems)
        except RunFileError as error:
            problems, expected = list(error.problems), None
        for problem in problems:
            say(f"{path}: {problem}", "red")
        for warning in expected.warnings if expected is not None and not quiet else ():
            say(f"{path}: warning: {warning}", "yellow")
        if as_json:
            found["problems"] = [problem._asdict() for problem in problems]
            numbers = expected and {key: value for key, value in expected._asdict().items() if key != "problems"}
            print_json(found | {"forecast": numbers})
        elif expected is not None and not problems and not quiet:
            print_rows(f"{path} is in order", forecast_rows(run_file, expected))
        wrong = wrong or bool(problems)
    if wrong:
        raise typer.Exit(BAD_DATA)


def precision_command(
    file: OneRunFile,
    overrides: Overrides = None,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Run FILE with its step, a half and a quarter of it; print the second quotient and the observed order.

    Writes no result. Exit code 1 when the observed order is not that of the integrator, to 0.2.
    """
    run_file = read_all([file], overrides)[file]
    scheme = run_file.prepared.plan.scheme
    if scheme.any_times:
        refuse_any_times(file, scheme.name)
    bar = not quiet and sys.stderr.isatty()
    with about(str(file), ValueError), printed_warnings(file, quiet):
        runs = [run_file.simulate(progress=bar)]
        h, store = runs[0].attrs["step"], run_file.time.store
        for n in (2, 4):
            kept = store if store == "end" else n * store
            runs.append(run_file.simulate(progress=bar, step=h / n, store=kept))
    numbers = {"file": str(file), **measured(runs, scheme.order)}  # type: ignore[attr-defined]
    if as_json:
        print_json(numbers)
    elif not quiet:
        print_precision(numbers)
    if not numbers["agrees"]:
        raise typer.Exit(DIFFERS)


def refuse_any_times(file: Path, name: str) -> NoReturn:
    """Refuse an integrator that has no order."""
    from ..integrators import INTEGRATORS

    known = ", ".join(f'"{name}"' for name, scheme in INTEGRATORS.items() if scheme.orders)
    raise CommandError(f'{file}: integrator.name: "{name}" -> one that steps: {known}', BAD_DATA)


def measured(runs: list[xarray.Dataset], order: int) -> dict[str, Any]:
    """Return quotients and orders at five times, their median, and what they say of the error of the first run."""
    import numpy as np

    from ..analysis.precision import second_quotient

    quotient = second_quotient(*runs)
    x = [run["directors"].values.reshape(run.sizes["time"], -1)[1:] for run in runs]
    coarse, fine = (np.linalg.norm(a - b, axis=1) for a, b in pairwise(x))
    clear = np.minimum(coarse, fine) > NOISE
    orders = np.log2(quotient.values, where=clear, out=np.full(len(fine), np.nan))
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
        "second_quotients": [float(q) if c else None for q, c in zip(quotient.values[at], clear[at], strict=True)],
        "observed_orders": [float(n) if c else None for n, c in zip(orders[at], clear[at], strict=True)],
    }


def print_precision(numbers: dict[str, Any]) -> None:
    """Print the table and the verdict."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"{numbers['file']}: steps h = {numbers['step']:.6g} s, h/2, h/4"), title_justify="left")
    for name in ("t (s)", "ξ(h/2) - ξ(h/4)", "Q_II", "observed order"):
        table.add_column(name, justify="right")
    columns = ("times", "differences", "second_quotients", "observed_orders")
    for t, d, q, n in zip(*(numbers[name] for name in columns), strict=True):
        table.add_row(f"{t:g}", f"{d:.1e}", *("–" if value is None else f"{value:.6f}" for value in (q, n)))
    out, median = stdout(), numbers["observed_order"]
    out.print(table)
    if median is None:
        out.print("no order to be seen: the runs differ by round-off only; a larger step shows one", markup=False)
        return
    verdict = (
        "agrees" if numbers["agrees"] else "DIFFERS: the step is too coarse, or the load has breakpoints off its grid"
    )
    out.print(f"observed order {median:.3f} (median), of the integrator {numbers['order']}: {verdict}", markup=False)
    out.print(f"error of the attitude at the end, with h: about {numbers['error_at_end']:.1e} rad", markup=False)
