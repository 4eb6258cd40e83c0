"""`nontwist twist`: the twist of a recording."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .options import Debug, Force, Json, Quiet
from .outcomes import about, say
from .summaries import print_json, print_rows

if TYPE_CHECKING:
    import xarray


def parse_axis(text: str) -> Any:
    """Return the axis of ``x``, ``y``, ``z`` (with a sign) or three numbers."""
    from ..geometry.arrays import as_axis

    try:
        return as_axis([float(part) for part in text.split(",")] if "," in text else text, "axis")
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is neither x, y, z nor three numbers like 0.1,0.2,0.97") from error


def _two_or_four(order: int) -> int:
    if order not in (2, 4):
        raise typer.BadParameter(f"{order} is neither 2 nor 4")
    return order


def twist_command(
    data: Annotated[str, typer.Argument(help="CSV, NPZ or NetCDF file; - for CSV on standard input.")],
    axis: Annotated[Any, typer.Option(help='x, y, z, or three numbers: "0.1,0.2,0.97".', parser=parse_axis)] = "z",
    axis_frame: Annotated[
        Literal["body", "space"], typer.Option(help="Whether the axis is fixed in the body or in space.")
    ] = "body",
    columns: Annotated[
        str | None,
        typer.Option(
            help="Headers to take: [TIME,] 4 of a quaternion or 9 of a matrix, with commas; numbers from 1 where there "
            "are no headers."
        ),
    ] = None,
    scalar_first: Annotated[
        bool | None,
        typer.Option("--scalar-first/--scalar-last", help="Order of quaternions whose headers do not tell."),
    ] = None,
    inverse: Annotated[
        bool, typer.Option("--inverse", help="The sensor reports earth relative to itself: invert every attitude.")
    ] = False,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", min=1e-9, help="Samples a second, where there is no time column.")
    ] = None,
    time_unit: Annotated[str | None, typer.Option(help="Unit of the time column: s, ms, us, ns, min, h.")] = None,
    order: Annotated[
        int, typer.Option(help="4: smooth path; 2: great circles between samples.", callback=_two_or_four)
    ] = 4,
    degrees: Annotated[bool, typer.Option("--degrees", help="Degrees in the summary, the figure and the CSV.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Where to write: PATH.nc, PATH.pdf.", show_default="NAME of DATA-twist, here")
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write the curves as PATH.csv as well.")] = False,
    figure: Annotated[bool, typer.Option(help="Draw PATH.pdf and PATH.png.")] = True,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> None:
    """Twist of a recorded motion about an axis: total, rate, swing-twist angle, solid angle, sampling quality.

    Columns are found by their headers, in any case and order: t or time, with a unit in brackets; qw qx qy qz or W X Y
    Z; r11 ... r33. Writes NetCDF and a figure; prints a summary, or with --json its numbers in SI units. Exit code 3
    for data that cannot be used.
    """
    from ..analysis.twisting import twist
    from ..io import read_motion
    from ..io.whole import require_free

    target = out or Path(f"{'stdin' if data == '-' else Path(data).stem}-twist")
    suffixes = (".nc", *[".csv"] * csv, *[".pdf", ".png"] * figure)
    places = {suffix: target.with_name(target.name + suffix) for suffix in suffixes}
    require_free(*places.values(), force=force)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with about(f"cannot read {data}", OSError), about(data, ValueError):
            chosen = [name.strip() for name in columns.split(",")] if columns else None
            source = sys.stdin if data == "-" else data
            motion, time = read_motion(source, chosen, scalar_first=scalar_first, time_unit=time_unit, inverse=inverse)
            time = _times(time, rate, len(motion))
            frame: Any = axis_frame
            result = twist(motion, time, axis=axis, axis_frame=frame, scalar_first=False, order=4 if order == 4 else 2)
    for warning in caught:
        say(f"warning: {warning.message}", "yellow")
    _write(result, places, degrees=degrees, force=force)
    if as_json:
        print_json({"file": data, **_facts(result)})
    elif not quiet:
        _summary(result, degrees)
    if not quiet:
        say(f"written: {', '.join(map(str, places.values()))}")


def _times(time: Any, rate: float | None, count: int) -> Any:
    """Return the times of the samples, s, from the file or from their rate."""
    import numpy as np

    if rate is None:
        return time
    if time is not None:
        raise typer.BadParameter("the file has a time column; leave --rate out", param_hint="--rate")
    return np.arange(count) / rate


def _facts(result: xarray.Dataset) -> dict[str, Any]:
    """Return the numbers of the summary, in rad, s, sr."""
    import numpy as np

    names = ("twist_angle", "error_estimate", "swing_twist_angle", "solid_angle", "path_length")
    facts: dict[str, Any] = {name: float(result[name].values[-1]) for name in names}
    if "twist_rate" in result:
        rate, time = result["twist_rate"].values, result["time"].values
        k, intervals = int(np.argmax(abs(rate))), np.diff(time)
        facts |= {"largest_twist_rate": float(rate[k]), "largest_twist_rate_time": float(time[k])}
        facts |= {"duration": float(time[-1] - time[0])}
        facts |= {"median_interval": float(np.median(intervals)), "largest_interval": float(intervals.max())}
    return facts | {k: result.attrs[k] for k in ("samples", "samples_left_out", "largest_turn_between_samples")}


def _write(result: xarray.Dataset, places: dict[str, Path], *, degrees: bool, force: bool) -> None:
    """Write what each suffix stands for."""
    from ..io import save_run
    from ..io.whole import written

    save_run(result, places[".nc"], force=force)
    if ".csv" in places:
        with written(places[".csv"], force=force) as file:
            _curves(result, degrees).to_csv(file, mode="wb")
    if ".pdf" in places:
        from .. import plot

        left, right = plot.new_axes(columns=2, height=2.6, panels=2)
        drawn = plot.path(result, left) + plot.twist_angle(result, right, swing=True, degrees=degrees)
        plot.save(drawn, places[".pdf"], places[".png"], force=force)


def _curves(result: xarray.Dataset, degrees: bool) -> Any:
    import numpy as np

    table = result[[name for name in result.data_vars if name != "frame"]].to_dataframe()
    if degrees:
        angles = [name for name in table if name != "solid_angle"]
        table[angles] = np.degrees(table[angles])
    return table


def _summary(result: xarray.Dataset, degrees: bool) -> None:
    import numpy as np

    scale, unit = (180 / np.pi, "°") if degrees else (1.0, " rad")
    found = _facts(result)
    psi, error = found["twist_angle"], found["error_estimate"]
    rows = {
        "total twist": f"{scale * psi:.6g}{unit} ({psi / (2 * np.pi):.4g} turns; sampling ± {scale * error:.1g}{unit})",
        "swing-twist angle": f"{scale * found['swing_twist_angle']:.6g}{unit}",
        "solid angle of the path": f"{found['solid_angle']:.6g} sr",
        "path of the axis": f"{scale * found['path_length']:.6g}{unit}",
    }
    lost = found["samples_left_out"]
    samples = f"{found['samples']}" + (f", {lost} left out" if lost else "")
    if "duration" in found:
        rate, when = scale * found["largest_twist_rate"], found["largest_twist_rate_time"]
        rows["largest twist rate"] = f"{rate:.6g}{unit}/s at t = {when:.6g} s"
        every, most = found["median_interval"], found["largest_interval"]
        samples += f", {found['duration']:.6g} s, every {every:.4g} s (at most {most:.4g} s)"
    rows["samples"] = samples
    rows["largest turn between samples"] = f"{scale * found['largest_turn_between_samples']:.4g}{unit}"
    print_rows(result.attrs["title"], rows)
