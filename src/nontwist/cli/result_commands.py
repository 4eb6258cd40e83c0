"""`nontwist info` and `nontwist export`: what a result file holds, and its numbers for other programs."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TextIO

import nontwist

from ..errors import ResultFileError
from ..geometry.values import nearest, number_text
from ..io.whole import require_free, written
from .outcomes import require_readable
from .printing import Dataset, print_rows, print_variables, printed_warnings, say_next, say_written
from .run_commands import body_rows, invariants_kept, rows_of_run, steps_of, times_of_events
from .shared_options import AsJson, DecimalComma, Force, Opt, argument, refuse, require_suffix

TOLD = {"file", "bytes", "title", "system", "load", "integrator", "step", "steps", "status", "message", "versions"}
TOLD |= {"conventions", "total_twist", "twist_defect", "tolerance", "error_estimate", "axis_frame", "mass"}
ANGLES = {"total_twist", "largest_turn_between_samples", "noise_level"}  # of a twist, rad
_SPELLED = {"read": "read as", "samples_left_out": "samples dropped", "run_file_sha256": "SHA-256 of the run file"}
Result = Annotated[Path, argument("RESULT", "A result file (NetCDF).")]
ResultOrStore = Annotated[Path, argument("RESULT", "A result file (NetCDF), or the store of a sweep.")]
COLUMNS = Opt(
    "Variables to export, separated by commas, as nontwist info or sweep-show lists them. Times, and the numbers of "
    "members, are always written. Those of events alone make a CSV table of events.",
    "NAMES",
    "--columns",
    default="all",
)
EULER = Opt("Add Euler angles and their rates: ZXZ about axes that turn with the body, zxz about fixed axes.", "AXES")
FORMAT = Opt("Format.", default="from the suffix of --out, or csv")


def info_command(result: Result, answer: AsJson) -> None:
    """Describe RESULT: its contents, how it was made, how it ended, and the drifts of its invariants.

    Reads the whole file and verifies its checksum. Exits with status 3 if it does not contain a run, or has been
    changed.
    """
    run = _opened(result)
    body = nontwist.DirectorSystem.from_json(run.attrs["system"]) if "system" in run.attrs else None
    if answer.in_words(found := _facts(run, result, body)):
        _print(found, body)


def export_command(
    result: ResultOrStore,
    to: Annotated[Literal["csv", "npz", "json"] | None, FORMAT] = None,
    out: Annotated[Path | None, Opt("File to write: .csv, .npz or .json.", "PATH", default="standard output")] = None,
    names: Annotated[str | None, COLUMNS] = None,
    degrees: Annotated[bool, Opt("Write angles and their rates in degrees; headers state it.")] = False,
    euler: Annotated[str | None, EULER] = None,
    decimal_comma: DecimalComma = False,
    force: Force = False,
) -> None:
    """Write the numbers of RESULT as flat columns, with units in their headers.

    CSV has one line for each stored state; quantities of intervals (moments, multipliers, work) are on the line at the
    end of their interval. Of a sweep it has one line for each member; of events, with --columns t_events, one for each,
    with its name. NPZ and JSON contain states along time,
    quantities of intervals along midtime, events, and in "record" how the run was made, in SI units.
    """
    from ..geometry.attitudes import require_sequence
    from ..io.run_files import in_degrees, with_euler, write_csv, write_json, write_npz

    if out is not None:
        require_suffix(out, *((".csv", ".npz", ".json") if to is None else (f".{to}",)))
    kind = to or (out.suffix.lower()[1:] if out is not None else "csv")
    refuse(
        (out is None and kind == "npz", "--out", "NPZ is binary: name a file, --out FILE.npz"),
        (decimal_comma and kind != "csv", "--decimal-comma", "applies to CSV only; omit it, or add --to csv"),
    )
    csv = partial(write_csv, decimal_comma=decimal_comma)
    if euler is not None:
        require_sequence(euler)
    writers: dict[str, Callable[[Dataset, TextIO], None]] = {"csv": csv, "json": write_json}
    write = writers.get(kind)

    def opened() -> Dataset:
        whole = _run_or_sweep(result)
        run = _chosen(whole, names, kind)
        if euler is not None:
            missing = {"quaternion", "material_angular_velocity"} - set(whole.data_vars)
            lacks = f"{result} has no {min(missing)}" if missing else "columns of events have no states"
            refuse((missing or not {"time", "member"} & set(run.dims), "--euler", lacks))
            with printed_warnings(result):
                angles = with_euler(whole, euler)
            run = run.assign({name: angles[name] for name in ("euler_angles", "euler_rates")})
        return in_degrees(run) if degrees else run

    if out is None and write is not None:
        write(opened(), sys.stdout)
    elif out is not None:
        require_free(out, force=force)
        run = opened()
        with written(out, force=force) as file:
            if write is None:
                write_npz(run, file)
            else:
                text = io.TextIOWrapper(file, encoding="utf-8", newline="")
                write(run, text)
                text.detach()
        say_written([out])


def _opened(path: Path) -> Dataset:
    """Return what a file holds along time or of members; a ResultFileError where it holds nothing of the kind."""
    require_readable(path)
    run = nontwist.open_run(path)
    if "time" not in run.indexes and "member" not in run.dims:
        raise ResultFileError(f"{path} does not contain a run: it has no coordinate time with its states along it")
    return run


def _run_or_sweep(path: Path) -> Dataset:
    """Return a run, or the members of a sweep, numbered, what was varied first."""
    if not path.is_dir():
        return _opened(path)
    from ..sweeps.opening import dataset
    from ..sweeps.store import open_store

    kept = open_store(path)
    members = dataset(kept)
    swept = [one.key for one in kept.members.sweep.over]
    ordered = members[[*swept, *(name for name in members.data_vars if name not in swept)]]
    return ordered.assign_coords(member=range(members.sizes["member"]))


def _chosen(run: Dataset, names: str | None, kind: str) -> Dataset:
    """Return a run or a sweep with these variables only, separated by commas; times and members stay.

    For CSV, variables of events come without states, whose lines are others.
    """
    from ..io.run_files import EVENTS, STATES

    if names is None:
        return run
    always, known = [name for name in ("time", "member") if name in run.coords], [str(name) for name in run.data_vars]
    chosen = [name for name in map(str.strip, names.split(",")) if name not in always]
    for name in chosen:
        refuse((name not in known, "--columns", f"there is no variable {name!r}; {nearest(name, known)}"))
    events = [name for name in chosen if EVENTS in run[name].dims]
    if kind == "csv" and events and STATES in run.dims:
        if other := [name for name in chosen if name not in events]:
            why = f"{events[0]} has a line for each event, {other[0]} has others; export them one after the other, or "
            refuse((True, "--columns", f"{why}both with --to json or --to npz"))
        return run[list(dict.fromkeys(["t_events", *events]))]
    return run[chosen].assign_coords({name: run[name] for name in always})


def _facts(run: Dataset, path: Path, body: nontwist.DirectorSystem | None) -> dict[str, Any]:
    """Return everything that `info` prints, as plain data."""
    from ..analysis.invariants import STATES
    from ..analysis.variables import VARIABLES
    from ..io.run_files import record

    attributes, time = record(run), run.indexes.get("time", ())
    facts: dict[str, Any] = {
        "file": str(path),
        "bytes": path.stat().st_size,
        **{name: value for name, value in attributes.items() if name != "memory"},
        "time": {"first": float(time[0]), "last": float(time[-1]), "states": len(time)} if len(time) else None,
        "dimensions": {str(name): size for name, size in run.sizes.items()},
        "variables": {
            str(name): {
                "dimensions": list(map(str, variable.dims)),
                "shape": list(variable.shape),
                "units": variable.attrs.get("units", "1"),
                "long_name": variable.attrs.get("long_name", ""),
            }
            for name, variable in run.data_vars.items()
        },
    }
    if len(time):
        facts |= steps_of(run)
    if "member" in run.dims and "status" in run:
        facts |= {"members": run.sizes["member"], "failed": int((run["status"] != 0).sum())}
    if "t_events" in run:
        facts["event_times"] = times_of_events(run)
    if "twist_angle" in run and len(time):
        facts["total_twist"] = float(run["twist_angle"].values[-1])
    if body is not None:
        facts["convected_inertia"] = body.convected_inertia.tolist()
        is_run = all(one in run and {*run[one].dims} == {*VARIABLES[one][0]} for one in STATES)
        if is_run and len(time):  # not a choice of variables, as `run[["kinetic_energy"]]`, or an ensemble
            facts |= invariants_kept(run)
    return facts


def _print(facts: dict[str, Any], body: nontwist.DirectorSystem | None) -> None:
    from ..viewer.content import NEEDED

    print_rows(facts.get("title", facts["file"]), _rows(facts, body))
    sizes = [zip(one["dimensions"], one["shape"], strict=True) for one in facts["variables"].values()]
    dimensions = [", ".join(f"{dim} {size}" for dim, size in one) for one in sizes]
    print_variables(facts["variables"], ("dimensions",), dimensions=dimensions)
    has = {*facts["variables"]}
    is_shown = "members" not in facts and ({"twist_angle", "twist_rate"} <= has or {*NEEDED} <= has)
    is_shown &= facts.get("axis_frame") != "space" and facts["time"] is not None and facts["time"]["states"] > 1
    say_next(*[("view", facts["file"])] * is_shown, ("export", facts["file"], "--out", "NAME.csv"))


def _rows(facts: dict[str, Any], body: nontwist.DirectorSystem | None) -> dict[str, str]:
    """Return the facts in words."""
    from ..analysis.joining import loads_in_words

    rows = {"file": f"{facts['file']}, {number_text(facts['bytes'] / 1e6, '.3g')} MB, checksum verified"}
    if body is not None:
        rows |= body_rows(body, (facts["mass"], facts["centre_of_mass"]) if "mass" in facts else None)
        rows["load"] = "\n".join(loads_in_words(facts.get("joined", [facts])))
    if facts["time"]:
        time = facts["time"]
        ends = time["first"], time["last"]
        first, last = (f"{t:.12g}" if body is None else repr(t).removesuffix(".0") for t in ends)
        rows["time"] = f"{first} s to {last} s, {time['states']} stored states"
    if "total_twist" in facts:
        rows["total twist"] = _words("total_twist", facts["total_twist"])
    rows |= rows_of_run(facts, facts.get("event_times", {}))
    if "status" in facts:
        rows["status"] = f"{facts['status']} ({facts['message']})"
    if "joined" in facts:
        seams = ", ".join(f"{part['t_start']:.6g}" for part in facts["joined"][1:])
        rows["joined"] = f"{len(facts['joined'])} runs, at t = {seams} s; integrator, error, run file are of the last"
    if "versions" in facts:
        rows["versions"] = ", ".join(f"{name} {value}" for name, value in facts["versions"].items())
    rest = {name: value for name, value in facts.items() if name not in TOLD and isinstance(value, (str, int, float))}
    return rows | {
        _SPELLED.get(name, name.replace("_", " ")): _words(name, value) for name, value in rest.items() if value != ""
    }


def _words(name: str, value: str | float) -> str:
    """Return an attribute in words: of a text its first line."""
    if name in ANGLES:
        return f"{number_text(float(value), '.4g')} rad ({number_text(math.degrees(float(value)), '.4g')}°)"
    text = str(value)
    lines = text.splitlines()
    return text if len(lines) < 2 else f"{lines[0]} … ({len(lines)} lines; all of it with --json)"
