"""`nontwist compare`: every integrator on the problem of a run file."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .options import Force, Json, OneRunFile, Opt, Overrides, Quiet
from .outcomes import BAD_DATA, SOLVER, CommandError, about, printed_warnings, say
from .run_commands import read_one
from .summaries import hint, in_words, print_fitting, say_written, set_again, typed

if TYPE_CHECKING:
    import xarray

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
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare integrators on the problem of FILE: errors, measured orders, drifts, run times.

    Ignores the tables [integrator] and [[event]] of FILE, and all of [time] except its span.
    """
    from .. import comparison, plot
    from ..comparison import compare
    from ..plot.journals import require_places

    if against != "seconds" and figure is None:
        raise typer.BadParameter("applies to --figure only; add --figure PATH", param_hint="--against")
    problem = read_one(file, overrides).problem.replace(times=None, events=None)
    chosen = [_choice(name) for name in integrators] if integrators else None
    if figure is not None:
        require_places(figure, force=force)
    with about(str(file), ValueError), printed_warnings(file):
        bar = not quiet and sys.stderr.isatty()
        found = compare(problem, integrators=chosen, steps=steps, progress=bar)
    is_read = in_words({"file": str(file), "reference": found.attrs["reference"], "runs": _rows(found)}, as_json, quiet)
    if is_read:
        if every:
            print_fitting(comparison.table(found))
        print_fitting(comparison.summary(found))
    if (found["status"] != 0).all():
        refused = bool((found["status"] < 0).all())
        raise CommandError(
            f"{file}: no integrator of this comparison solved the problem", BAD_DATA if refused else SOLVER
        )
    if is_read:
        again = " ".join([typed(file), *set_again(overrides)])
        say(hint(f"nontwist precision {again}", f"nontwist run {again}"))
    if figure is not None:
        plot.save(plot.work_precision(found, against=against), figure, force=force)
        say_written([figure])


def _choice(text: str) -> str | tuple[str, int]:
    name, sign, order = text.partition(":")
    if not sign:
        return name
    if not order.isdecimal():
        raise typer.BadParameter(f"{text!r} is not NAME:ORDER, for example gauss:8", param_hint="--integrator")
    return name, int(order)


def _rows(found: xarray.Dataset) -> list[dict[str, Any]]:
    """Return every run as plain data; what it does not have is null."""
    rows = []
    for name in found["integrator"].values:
        group = found.sel(integrator=name)
        stepping = bool(group["takes_steps"])
        for h in group["step"].values[: None if stepping else 1]:
            run = group.sel(step=h)
            numbers = {key: float(run[key]) for key in NUMBERS if key in run}
            row = {key: number if math.isfinite(number) else None for key, number in numbers.items()}
            drift = dict(zip(run["invariant"].values.tolist(), run["drift"].values.tolist(), strict=True))
            row |= {f"drift_{key}": value if math.isfinite(value) else None for key, value in drift.items()}
            status = {"status": int(run["status"]), "message": str(run["message"].values)}
            rows.append({"integrator": str(name), "step": float(h) if stepping else None, **row, **status})
    return rows
