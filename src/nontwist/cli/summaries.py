"""What the commands on run files print: tables for people, plain data for programs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from .outcomes import stdout

if TYPE_CHECKING:
    import xarray

    from ..runfile import RunFile
    from ..runfile.forecast import Forecast

MOST_TIMES = 5  # of an event, in a table


def print_json(data: dict[str, Any]) -> None:
    """Print an object on one line; numbers that are not finite are null."""
    import math

    plain = {
        key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in data.items()
    }
    print(json.dumps(plain, ensure_ascii=False, allow_nan=False))


def print_rows(title: str, rows: dict[str, str]) -> None:
    """Print a title and two columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", show_header=False)
    for name, text in rows.items():
        table.add_row(name, Text(text))
    stdout().print(table)


def forecast_rows(run_file: RunFile, forecast: Forecast) -> dict[str, str]:
    """Return what a run will be like, in words."""
    from ..driver.costs import amount, duration

    scheme = run_file.prepared.scheme
    order = getattr(scheme, "order", None)
    rows = {
        "body": run_file.body.kind,
        "loads": ", ".join(load.kind for load in run_file.load) or "none",
        "integrator": scheme.name + (f", order {order}" if order else ""),
    }
    span = f"t = {run_file.time.t_start:g} s to {run_file.time.t_end:g} s"
    automatic = " (automatic)" if run_file.time.step is None else ""
    if scheme.any_times:
        rows["output"] = f"{forecast.states} states, {span}, every {forecast.step:.6g} s{automatic}"
    else:
        most = "at most " * (len(run_file.prepared.grid.sizes) > 1)
        rows["steps"] = f"{forecast.steps} of {most}{forecast.step:.6g} s{automatic}, {span}"
        rows["turn a step"] = f"at most {forecast.turn:.3g}°"
    if run_file.prepared.plan.is_controlled:
        rows["tolerance"] = f"{run_file.prepared.plan.goal:g} rad; order and steps are a first estimate"
    elif forecast.phase_error is not None:
        rows["phase error"] = f"about {forecast.phase_error:.1g}° at the end, for a steady rotation as fast"
    rows["result"] = f"{forecast.states} states, about {amount(forecast.size)} of memory"
    rows["time"] = f"about {duration(forecast.seconds)}, compilation left out"
    if run_file.sweep is not None:
        keys = ", ".join(one.key for one in run_file.sweep.over)
        time = f"about {duration(forecast.sweep_seconds or 0.0)} on one core"
        rows["sweep"] = f"{run_file.sweep.members} members over {keys}, {time}; nontwist sweep --dry-run tells more"
    return rows


def run_numbers(run: xarray.Dataset) -> dict[str, Any]:
    """Return what was done in a run and how well its invariants were kept, as plain data."""
    from ..analysis.invariants import drifts, twist_defect
    from ..analysis.trajectory import stretches_from

    time, iterations = run["time"].values, run.get("newton_iterations")
    span, grid = float(time[-1] - time[0]), stretches_from(run.attrs.get("stretches"))
    numbers: dict[str, Any] = {
        "title": run.attrs["title"],
        "status": int(run.attrs["status"]),
        "message": run.attrs["message"],
        "integrator": json.loads(run.attrs["integrator"]),
        "steps": round(span / run.attrs["step"]) if grid is None else grid.steps,
        "step": float(run.attrs["step"]),
        "t_start": float(time[0]),
        "t_end": float(time[-1]),
        "states": len(time),
        "drift": {name: drift._asdict() for name, drift in drifts(run).items()},
        "newton_iterations": int(iterations.values.max()) if iterations is not None and iterations.size else None,
    }
    if grid is not None:
        numbers["stretches"] = len(grid.sizes)
    if "tolerance" in run.attrs:
        numbers |= {name: float(run.attrs[name]) for name in ("tolerance", "error_estimate")}
    if "warning" in run.attrs:
        numbers["warning"] = run.attrs["warning"]
    if "t_events" in run:
        names, times = run["event_name"].values.tolist(), run["t_events"].values.tolist()
        asked = json.loads(run.attrs["events"])
        numbers["events"] = {one: [t for t, name in zip(times, names, strict=True) if name == one] for one in asked}
    if (defect := twist_defect(run)) is not None:
        numbers["twist_defect"] = defect
    return numbers


def run_rows(numbers: dict[str, Any]) -> dict[str, str]:
    """Return the numbers of a run in words."""
    scheme = numbers["integrator"]
    rows = {
        "integrator": scheme["name"] + (f", order {scheme['order']}" if "order" in scheme else ""),
        "steps": f"{numbers['steps']} of {'at most ' * ('stretches' in numbers)}{numbers['step']:.6g} s",
        "time": f"{numbers['t_start']:g} s to {numbers['t_end']:g} s",
        "states": str(numbers["states"]),
    }
    if "tolerance" in numbers:
        rows["error"] = f"estimated as {numbers['error_estimate']:.1e} rad, tolerance {numbers['tolerance']:g}"
    if "warning" in numbers:
        rows["warning"] = numbers["warning"]
    for name, drift in numbers["drift"].items():
        words = name.replace("_", " ")
        if name == "orthonormality":
            rows[words] = f"defect {drift['absolute']:.1e}"
        else:
            rows[words] = (
                f"drift {drift['relative']:.1e} relative, {drift['absolute']:.1e} {drift['units']} ({drift['symbol']})"
            )
    if "twist_defect" in numbers:
        rows["twist defect"] = f"{numbers['twist_defect']:.1e} rad/s"
    if numbers["newton_iterations"]:
        rows["Newton iterations"] = f"at most {numbers['newton_iterations']} a step"
    for name, times in numbers.get("events", {}).items():
        more = f", ... ({len(times)})" if len(times) > MOST_TIMES else ""
        rows[f"event {name}"] = f"t = {', '.join(f'{t:.9g}' for t in times[:MOST_TIMES])} s{more}" if times else "none"
    if numbers["status"] == 0 and numbers["message"] != "done":
        rows["end"] = numbers["message"]
    if "seconds" in numbers:
        rows["time taken"] = f"{numbers['seconds']:.3g} s"
    return rows
