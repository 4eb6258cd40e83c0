"""`nontwist fit`: the inertia of what was thrown, or swings on a pivot."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .options import Force, Json, Opt, Quiet, Reading, argument, refuse
from .outcomes import BAD_DATA, require_readable
from .printing import in_words, print_rows, say, say_written

SETTINGS = {
    "gravity": Opt(
        "The body turns about a pivot under gravity: mass=KG,centre=X,Y,Z (m, from the pivot, in the axes of the "
        "sensor), or mass=KG,distance=M, with g=M/S2 if it is not 9.81; or unknown.",
        "SETTINGS",
    ),
    "rotor": Opt(
        "A rotor of known momentum in the body: axis=z, -x, X,Y,Z or fit, inertia=KGM2, speed=COLUMN or speed=RAD/S; "
        "unit=rpm if the column does not state it; error=0.01 for an error of 1 % of its momentum.",
        "SETTINGS",
    ),
    "orientation": Opt(
        "Fit the attitudes in the file, alone or with the angular velocity; use=both,euler=ZYX, or scalar_first, "
        "rotation_vector, normalize, inverse=true, angle_unit=deg, as twist reads them.",
        "only|both|SETTINGS",
    ),
    "delay": Opt(
        "Delay of the gyroscope's readings: seconds; or fit, which requires attitudes or the speed of a rotor on the "
        "same clock; or value=0.01,error=0.002.",
        "S|fit|SETTINGS",
    ),
    "misalignment": Opt(
        "Rotation vector from the axes of the body to those of the gyroscope, rad; or fit; or "
        "value=0,0.1,0,error=0.02.",
        "X,Y,Z|fit|SETTINGS",
    ),
    "axis_scales": Opt(
        "Scales of the gyroscope's single axes, about 1; or fit; or value=1,1,1,error=0.01.", "X,Y,Z|fit|SETTINGS"
    ),
    "damping": Opt(
        "Damping, a moment -C W: fit one C, or three along the axes; or give C, N m s, 1 or 3 numbers.", "one|three|C"
    ),
    "constraint": Opt("The body may not turn about its axis x, y, z, or X,Y,Z: W·n = 0.", "AXIS"),
}
READING = Reading(
    ("columns", "time_column", "body", "time_unit", "rate"),
    {
        "columns": "Columns to use, separated by commas: [TIME,] 3 of the angular velocity.",
        "body": "Which of several sensors to use: a value of the column that names the sensor of each row, or the "
        "common beginning of its headers.",
    },
)
UNIT = Opt("Unit of angular velocities, if their headers do not name it: rad/s, deg/s.", "UNIT")
BIAS = Opt("Prior standard deviation of the gyroscope's bias.", "RAD/S", least=1e-12)
SCALE = Opt("Prior standard deviation of its scale: 0.01 for 1 %.", "RATIO", least=1e-12)


def fit_command(
    data: Annotated[
        list[str], argument("FILE", "Recordings of one body with one sensor; - for CSV on standard input.")
    ],
    first: Annotated[float | None, Opt("Start of the motion to fit, s; in every recording.", "T", "--from")] = None,
    last: Annotated[float | None, Opt("End of the motion to fit, s.", "T", "--to")] = None,
    everything: Annotated[bool, Opt("Fit all samples.", option="--all")] = False,
    gravity: Annotated[str | None, SETTINGS["gravity"]] = None,
    rotor: Annotated[str | None, SETTINGS["rotor"]] = None,
    damping: Annotated[str | None, SETTINGS["damping"]] = None,
    constraint: Annotated[str | None, SETTINGS["constraint"]] = None,
    unphysical: Annotated[bool, Opt("Also accept a J with a moment larger than the sum of the others.")] = False,
    orientation: Annotated[str | None, SETTINGS["orientation"]] = None,
    *,
    reading: Annotated[dict[str, Any], READING],
    unit: Annotated[str | None, UNIT] = None,
    bias: Annotated[float, BIAS] = 0.02,
    scale: Annotated[float, SCALE] = 0.01,
    delay: Annotated[str | None, SETTINGS["delay"]] = None,
    misalignment: Annotated[str | None, SETTINGS["misalignment"]] = None,
    axis_scales: Annotated[str | None, SETTINGS["axis_scales"]] = None,
    noise: Annotated[
        float | None, Opt("Noise of a sample.", "RAD/S", default="that of the residuals", least=1e-12)
    ] = None,
    loss: Annotated[Literal["linear", "soft_l1"], Opt("With soft_l1, outliers have less weight.")] = "linear",
    out: Annotated[Path | None, Opt("Write the motion of the first recording as a run file.", "PATH")] = None,
    figure: Annotated[Path | None, Opt("Draw data, model, residuals and moments: .pdf, .svg, .png.", "PATH")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the inertia of a body from recordings of its motion: moments, principal axes, 95 % intervals.

    The columns of the gyroscope are found by their headers: gx gy gz, gyr_x, Gyroscope x (rad/s). The interval between
    release and catch is found, or given with --from and --to. Free motion determines only ratios; on a pivot
    (--gravity), or with a rotor (--rotor), the inertia is found in kg m². Exits with status 3 if the recordings cannot
    be used, do not determine every number (the undetermined ones are then named), or are not explained by noise and
    model.
    """
    from ..fitting import fit_inertia
    from ..io.whole import require_free

    refuse(
        (everything and (first is not None or last is not None), "--all", "--from and --to name a part"),
        ((first is None) != (last is None), "--from" if last is None else "--to", "--from and --to go together"),
        (len(data) > 1 and "-" in data, "FILE...", "standard input is read once, and alone"),
    )
    for one in data:
        require_readable(Path(one), "a recording")
    if out is not None:
        require_free(out, force=force)
    if figure is not None:
        from ..plot.journals import require_places

        require_places(figure, force=force)
    interval: Any = "all" if everything else None if first is None else (first, last)
    what: Any = [sys.stdin if one == "-" else one for one in data]
    words = (gravity, rotor, orientation, delay, misalignment, axis_scales, damping, constraint)
    acting = {name: settings(text, name) for name, text in zip(SETTINGS, words, strict=True)}
    how: Any = {"bias": bias, "scale": scale, "noise": noise, "loss": loss, "unit": unit, **reading, **acting}
    how["physical"] = not unphysical
    fit = fit_inertia(what if len(what) > 1 else what[0], interval=interval, **how)
    rows, numbers = fit.table(), fit.numbers()
    if in_words({"files": data, **numbers}, as_json, quiet):
        print_rows(f"inertia of {', '.join(data)}", rows)
    made = []
    if figure is not None:
        from .. import plot

        plot.save(fit.plot(), figure, force=force)
        made.append(figure)
    done = fit.is_explained and not fit.untold
    if out is not None and done:
        fit.problem().write(out, force=force)
        made.append(out)
    if made and not quiet:
        say_written(made)
    if not done:
        if out is not None:
            undetermined = "the recordings do not determine the inertia"
            why = undetermined if fit.untold else "the model does not explain the recordings"
            say(f"not written: {out}, because {why}", "red")
        raise typer.Exit(BAD_DATA)


WORDS = ("gravity", "rotor", "orientation")  # whose text without settings is one word


def settings(text: str | None, name: str) -> Any:
    """Return the value of an option such as ``mass=0.35,centre=0,0,-0.1``: a mapping of what is set, or one value."""
    option, found, key = f"--{name.replace('_', '-')}", dict[str, list[str]](), ""
    if text is None or ("=" not in text and name in WORDS):
        return text
    if "=" not in text:
        return _value(text.split(","), option)
    for part in text.split(","):
        setting, is_set, value = part.rpartition("=")
        refuse((not is_set and not key, option, f"{part.strip()!r} is before the first NAME="))
        if is_set:
            key = setting.strip()
            refuse((key in found, option, f"{key} is set twice"))
        found.setdefault(key, []).append(value.strip() if is_set else part.strip())
    return {key: _value(values, f"{key} of {option}") for key, values in found.items()}


def _value(parts: list[str], name: str) -> Any:
    """Return a word, a number, or a list of numbers."""
    try:
        numbers = [float(part) for part in parts]
    except ValueError as error:
        if len(parts) == 1:
            return parts[0]
        raise typer.BadParameter(f"{name} must be numbers, got {','.join(parts)!r}") from error
    return numbers[0] if len(numbers) == 1 else numbers
