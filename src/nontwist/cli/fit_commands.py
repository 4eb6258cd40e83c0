"""`nontwist fit`: the inertia of what was thrown, or swings on a pivot."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .options import Debug, Force, Json, Quiet, reads
from .outcomes import BAD_DATA, require_readable, say, words
from .summaries import print_json, print_rows


@reads(
    "columns",
    "time_column",
    "body",
    "time_unit",
    "rate",
    columns="Columns to use, separated by commas: [TIME,] 3 of the angular velocity.",
    body="Which of several sensors to use: a value of the column that names the sensor of each row, or the common "
    "beginning of its headers.",
)
def fit_command(
    data: Annotated[
        list[str],
        typer.Argument(metavar="FILE", help="Recordings of one body with one sensor; - for CSV on standard input."),
    ],
    first: Annotated[
        float | None, typer.Option("--from", metavar="T", help="Start of the motion to fit, s; in every recording.")
    ] = None,
    last: Annotated[float | None, typer.Option("--to", metavar="T", help="End of the motion to fit, s.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Fit all samples.")] = False,
    gravity: Annotated[
        str | None,
        typer.Option(
            metavar="SETTINGS",
            help="The body turns about a pivot under gravity: mass=KG,centre=X,Y,Z (m, from the pivot, in the axes of "
            "the sensor), or mass=KG,distance=M, with g=M/S2 if it is not 9.81; or unknown.",
        ),
    ] = None,
    rotor: Annotated[
        str | None,
        typer.Option(
            metavar="SETTINGS",
            help="A rotor of known momentum in the body: axis=z, -x, X,Y,Z or fit, inertia=KGM2, speed=COLUMN or "
            "speed=RAD/S; unit=rpm if the column does not state it; error=0.01 for an error of 1 % of its momentum.",
        ),
    ] = None,
    damping: Annotated[
        str | None,
        typer.Option(
            metavar="one|three|C",
            help="Damping, a moment -C W: fit one C, or three along the axes; or give C, N m s, 1 or 3 numbers.",
        ),
    ] = None,
    constraint: Annotated[
        str | None,
        typer.Option(metavar="AXIS", help="The body may not turn about its axis x, y, z, or X,Y,Z: W·n = 0."),
    ] = None,
    orientation: Annotated[
        str | None,
        typer.Option(
            metavar="only|both|SETTINGS",
            help="Fit the attitudes in the file, alone or with the angular velocity; use=both,euler=ZYX, or "
            "scalar_first, rotation_vector, normalize, inverse=true, angle_unit=deg, as twist reads them.",
        ),
    ] = None,
    *,
    reading: Any,
    unit: Annotated[
        str | None,
        typer.Option(metavar="UNIT", help="Unit of angular velocities, if their headers do not name it: rad/s, deg/s."),
    ] = None,
    bias: Annotated[
        float, typer.Option(metavar="RAD/S", min=1e-12, help="Prior standard deviation of the gyroscope's bias.")
    ] = 0.02,
    scale: Annotated[
        float, typer.Option(metavar="RATIO", min=1e-12, help="Prior standard deviation of its scale: 0.01 for 1 %.")
    ] = 0.01,
    delay: Annotated[
        str | None,
        typer.Option(
            metavar="S|fit|SETTINGS",
            help="Delay of the gyroscope's readings: seconds; or fit, which requires attitudes or the speed of a rotor "
            "on the same clock; or value=0.01,error=0.002.",
        ),
    ] = None,
    misalignment: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z|fit|SETTINGS",
            help="Rotation vector from the axes of the body to those of the gyroscope, rad; or fit; or "
            "value=0,0.1,0,error=0.02.",
        ),
    ] = None,
    axis_scales: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z|fit|SETTINGS",
            help="Scales of the gyroscope's single axes, about 1; or fit; or value=1,1,1,error=0.01.",
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(metavar="RAD/S", min=1e-12, help="Noise of a sample.", show_default="that of the residuals"),
    ] = None,
    loss: Annotated[
        Literal["linear", "soft_l1"],
        typer.Option(metavar="linear|soft_l1", help="With soft_l1, outliers have less weight."),
    ] = "linear",
    out: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Write the motion of the first recording as a run file.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Draw data, model, residuals and moments: .pdf, .svg, .png.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
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

    if everything and (first is not None or last is not None):
        raise typer.BadParameter("--from and --to name a part", param_hint="--all")
    if (first is None) != (last is None):
        raise typer.BadParameter("--from and --to go together", param_hint="--from" if last is None else "--to")
    if len(data) > 1 and "-" in data:
        raise typer.BadParameter("standard input is read once, and alone", param_hint="FILE...")
    for one in data:
        require_readable(Path(one), "a recording")
    if out is not None:
        require_free(out, force=force)
    if figure is not None:
        from ..plot.journals import require_places

        require_places(figure, force=force)
    interval: Any = "all" if everything else None if first is None else (first, last)
    what: Any = [sys.stdin if one == "-" else one for one in data]
    acting = {"gravity": settings(gravity, "--gravity"), "rotor": settings(rotor, "--rotor")}
    acting |= {"orientation": settings(orientation, "--orientation")}
    acting |= {
        name.strip("-").replace("-", "_"): _coefficients(given, name)
        if "=" not in (given or "")
        else settings(given, name)
        for name, given in (("--delay", delay), ("--misalignment", misalignment), ("--axis-scales", axis_scales))
    }
    acting |= {"damping": _coefficients(damping), "constraint": _coefficients(constraint, "--constraint")}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        how: Any = {"bias": bias, "scale": scale, "noise": noise, "loss": loss, "unit": unit, **reading, **acting}
        fit = fit_inertia(what if len(what) > 1 else what[0], interval=interval, **how)
        rows, numbers = fit.table(), fit.numbers()
    for warning in caught:
        say(f"warning: {words(warning.message)}", "yellow")
    if as_json:
        print_json({"files": data, **numbers})
    elif not quiet:
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
        say(f"written: {', '.join(map(str, made))}")
    if not done:
        if out is not None:
            undetermined = "the recordings do not determine the inertia"
            why = undetermined if fit.untold else "the model does not explain the recordings"
            say(f"not written: {out}, because {why}", "red")
        raise typer.Exit(BAD_DATA)


def settings(text: str | None, option: str) -> Any:
    """Return the value of an option such as ``mass=0.35,centre=0,0,-0.1``: a word, or a mapping of what is set."""
    if text is None or "=" not in text:
        return text
    found: dict[str, list[str]] = {}
    key = ""
    for part in text.split(","):
        name, is_set, value = part.rpartition("=")
        if not is_set and not key:
            raise typer.BadParameter(f"{part.strip()!r} is before the first NAME=", param_hint=option)
        if is_set:
            key = name.strip()
            if key in found:
                raise typer.BadParameter(f"{key} is set twice", param_hint=option)
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


def _coefficients(text: str | None, option: str = "--damping") -> Any:
    """Return the value of an option that is a word, a number or a list of numbers."""
    return None if text is None else _value(text.split(","), option)
