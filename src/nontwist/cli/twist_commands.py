"""`nontwist twist`: the twist of a recording."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ..errors import SENTENCES, InputError, ShellOptions
from ..recordings.options import ReadOptions
from ..spec import specs
from .options import DecimalComma, Force, Json, Opt, Quiet, Reading, argument, looks_like_a_file, names_of
from .outcomes import BAD_DATA, CommandError, about, printed_warnings, require_readable
from .summaries import in_words, say_written, typed
from .twist_results import facts, summary, write

READING = tuple(name for name in specs(ReadOptions) if name not in ("columns", "body"))


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


DATA = argument(
    "DATA", "Recording: CSV, OpenSim, MVNX, BVH, NumPy, MATLAB, C3D, ROS or NetCDF; - for CSV on standard input."
)
SECOND = Opt("Recording of a second sensor; measure the twist relative to it.", "FILE")
SECOND_READ = Opt('How to read FILE, if not like DATA: "--inverse --time-unit ms", or "".', "OPTIONS")
CLOCKS = Opt(
    "Clocks of the two sensors: shared, or with a shift, or shift and drift, found from angular speeds.",
    default="shared for one file; for two files, from their dates or times",
)
SHAKE = Opt(
    "Interval in which both sensors were shaken together (s, times of DATA): aligns the clocks by it alone. Repeat it "
    "for a second shake, as --clocks drift requires.",
    "T0,T1",
)
ALIGN = Opt("Correct the mounting: at rest, the axes of both bodies are parallel to those of space.")
STATIC = Opt("Interval at rest (s).", "T0,T1", default="the second in which all turn least")
ORDER = Opt("4 for a smooth path, 2 for great circles between samples.", "2|4", check=_two_or_four)
RESULTS = Opt("Results to write: NAME.nc, NAME.pdf, NAME.png.", "NAME", default="DATA-twist here")


def twist_command(
    ctx: typer.Context,
    data: Annotated[str, DATA],
    axis: Annotated[Any, Opt('Axis: x, y, z, or three numbers "0.1,0.2,0.97".', "AXIS", parser=parse_axis)] = "z",
    axis_frame: Annotated[Literal["body", "space"], Opt("Whether the axis is fixed in the body or in space.")] = "body",
    *,
    reading: Annotated[dict[str, Any], Reading()],
    relative_to: Annotated[str | None, SECOND] = None,
    relative_options: Annotated[str | None, SECOND_READ] = None,
    relative_columns: Annotated[str | None, Opt("Columns of the second sensor, in FILE or DATA.", "HEADERS")] = None,
    relative_body: Annotated[str | None, Opt("Body of the second sensor, in FILE or DATA.", "NAME")] = None,
    clocks: Annotated[Literal["shared", "shift", "drift"] | None, CLOCKS] = None,
    shake: Annotated[list[str] | None, SHAKE] = None,
    align: Annotated[Literal["static"] | None, ALIGN] = None,
    static: Annotated[str | None, STATIC] = None,
    order: Annotated[int, ORDER] = 4,
    degrees: Annotated[bool, Opt("Use degrees in the summary, the figure and the CSV file.")] = False,
    out: Annotated[Path | None, RESULTS] = None,
    csv: Annotated[bool, Opt("Also write the curves to NAME.csv.")] = False,
    decimal_comma: DecimalComma = False,
    figure: Annotated[bool, Opt("Draw NAME.pdf and NAME.png.", option="--figure/--no-figure")] = True,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the twist of a recorded motion about an axis, with swing-twist angle, solid angle and error estimates.

    Columns are found by their headers, in any case and order: t or time, with a unit in brackets; qw qx qy qz or W X Y
    Z; r11 ... r33; angles with --euler. --relative-to, --relative-columns or --relative-body measure the twist of a
    joint, relative to a second sensor. Writes NetCDF and a figure; prints a summary, or with --json its numbers in SI
    units. Exits with status 3 if the data cannot be used.
    """
    from ..io.whole import require_free
    from ..recordings.reading import read_motion
    from ..recordings.twisting import twist

    require_readable(Path(data), "a recording")
    if decimal_comma and not csv:
        raise typer.BadParameter("applies to CSV only; add --csv", param_hint="--decimal-comma")
    target = _named(out) if out is not None else Path(f"{'stdin' if data == '-' else Path(data).stem}-twist")
    suffixes = (".nc", *[".csv"] * csv, *[".pdf", ".png"] * figure)
    places = {suffix: target.with_name(target.name + suffix) for suffix in suffixes}
    read = [Path(one) for one in (data, relative_to) if one is not None and Path(one).exists()]
    for place in places.values():
        if place.exists() and any(place.samefile(one) for one in read):
            raise typer.BadParameter(f"{place} is the recording itself; choose another name", param_hint="--out")
    require_free(*places.values(), force=force)
    with printed_warnings():
        with about(f"cannot read {data}", OSError), about(data, ValueError):
            motion = read_motion(sys.stdin if data == "-" else data, **reading)
        second = relative_to or (data if relative_columns or relative_body else None)
        if relative_options is not None and relative_to is None:
            raise typer.BadParameter("there is no second file: --relative-to FILE", param_hint="--relative-options")
        for option, value in (("--clocks", clocks), ("--shake", shake)):
            if second is None and value:
                raise typer.BadParameter("there is no second sensor: --relative-to FILE", param_hint=option)
        if static is not None and align is None:
            raise typer.BadParameter("requires --align static", param_hint="--static")
        if second == "-":
            raise typer.BadParameter("standard input is read once; save it in a file", param_hint="--relative-to")
        other = None
        if second is not None:
            own = dict(reading) if relative_options is None else _reading(ctx, second, relative_options)
            own |= {"columns": names_of(relative_columns), "body": relative_body}
            with about(f"cannot read {second}", OSError), about(second, ValueError), _of_the_second(second):
                other = read_motion(second, **own)
        with about(data, ValueError):
            result = twist(
                motion,
                axis=axis,
                axis_frame=axis_frame,
                relative_to=other,
                clocks=clocks or (None if relative_to else "shared"),
                shake=[_pair(one, "--shake") for one in shake] if shake else None,
                align=align,
                static=None if static is None else _pair(static, "--static"),
                order=4 if order == 4 else 2,
            )
    result.attrs["read"] = motion.attrs["notes"]
    if other is not None:
        result.attrs["relative_to"] = f"{second}: {other.attrs['notes']}"
    write(result, places, degrees=degrees, decimal_comma=decimal_comma, force=force)
    if in_words({"file": data, **facts(result)}, as_json, quiet):
        summary(result, degrees)
    if not quiet:
        say_written(places.values(), f"nontwist view {typed(places['.nc'])}")


def _named(out: Path) -> Path:
    """Return the name of the results without its suffix, which is .nc or none."""
    if looks_like_a_file(out) and out.suffix.lower() != ".nc":
        more = {".csv": "; --csv adds the curves", ".pdf": " and draws it", ".png": " and draws it"}
        hint = f"--out {out.with_suffix('')} writes {out.with_suffix('.nc')}{more.get(out.suffix.lower(), '')}"
        raise typer.BadParameter(f"{out} names one file; {hint}", param_hint="--out")
    return out.with_suffix("") if out.suffix.lower() == ".nc" else out


def _reading(ctx: typer.Context, file: str, text: str) -> dict[str, Any]:
    """Return how the second file is read, from its options as they stand on a command line."""
    hint = "--relative-options"
    try:
        given = shlex.split(text)
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} has a quotation mark too few", param_hint=hint) from error
    if {"-h", "--help"} & set(given):
        raise typer.BadParameter(
            "it accepts options that define how a file is read; nontwist twist -h lists them", param_hint=hint
        )
    own = ctx.command.make_context("twist", [file, *given], parent=ctx.parent)
    said = [name for name in own.params if getattr(own.get_parameter_source(name), "name", "") == "COMMANDLINE"]
    other = [name for name in said if name not in (*READING, "data")]
    if other:
        known = ", ".join(f"--{name.replace('_', '-')}" for name in READING)
        advice = {"columns": "; use --relative-columns", "body": "; use --relative-body"}.get(other[0], "")
        raise typer.BadParameter(
            f"--{other[0].replace('_', '-')} is not one of {known}{advice}",
            param_hint=hint,
        )
    return {name: own.params[name] for name in READING}


@contextmanager
def _of_the_second(file: str) -> Iterator[None]:
    """Name the options of the second file where a message names those of the first."""
    try:
        yield
    except InputError as error:
        own = ShellOptions(body="--relative-body", columns="--relative-columns")
        sentence = SENTENCES[error.code]
        needs_more = "{option[" in sentence and not any(f"[{name}]" in sentence for name in ("body", "columns"))
        more = '; for this file alone: --relative-options "..."' if needs_more else ""
        raise CommandError(f"{file}: {error.worded(own)}{more}", BAD_DATA) from error


def _pair(text: str, option: str) -> tuple[float, float]:
    """Return the two times of ``T0,T1``."""
    try:
        first, last = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is not two times like 0,2.5", param_hint=option) from error
    return first, last
