"""`nontwist twist` and `nontwist fit`: what recordings tell, the twist of a motion and the inertia of a body."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import nontwist

from ..errors import SENTENCES, InputError, Option, ShellOptions
from ..geometry.values import error_place, error_text, number_text, text_to_place
from ..io.whole import require_free, written
from ..recordings.options import ReadOptions
from .outcomes import BAD_DATA, CommandError, about, require_readable
from .printing import Dataset, print_rows, say
from .shared_options import (
    Answer,
    DecimalComma,
    Opt,
    argument,
    looks_like_a_file,
    names_of,
    numbers_of,
    read_otherwise,
    refuse,
    settings,
)

ROUND_OFF = 1e-14  # rad
MOST = 0.9  # of an error: what makes more is named as its cause
DIGITS = 1e-2  # of its error: a number below it has no digit that means anything
TIMES = "two times like 0,2.5"


def parse_axis(text: str) -> Any:
    """Return the axis of ``x``, ``y``, ``z`` (with a sign) or three numbers."""
    from ..geometry.arrays import as_axis

    try:
        return as_axis([float(part) for part in text.split(",")] if "," in text else text, "axis")
    except ValueError as error:
        wanted = "x, y, z or three numbers like 0.1,0.2,0.97 in the axes of the body (--body names one)"
        raise typer.BadParameter(f"{text!r} is not a direction: {wanted}") from error


DATA = argument(
    "DATA", "Recording: CSV, OpenSim, MVNX, BVH, NumPy, MATLAB, C3D, ROS or NetCDF; - for CSV on standard input."
)
SECOND = Opt("Recording of a second sensor; measure the twist relative to it.", "FILE")
SECOND_READ = Opt('How to read the second sensor, if not like the first: "--inverse --time-unit ms", or "".', "OPTIONS")
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
ORDER = Opt("4 for a smooth path, 2 for great circles between samples.", "2|4")
RESULTS = Opt("Results to write: NAME.nc, NAME.pdf, NAME.png.", "NAME", default="DATA-twist here")


def twist_command(
    ctx: typer.Context,
    data: Annotated[str, DATA],
    axis: Annotated[Any, Opt('Axis: x, y, z, or three numbers "0.1,0.2,0.97".', "AXIS", parser=parse_axis)] = "z",
    axis_frame: Annotated[Literal["body", "space"], Opt("Whether the axis is fixed in the body or in space.")] = "body",
    *,
    reading: ReadOptions,
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
    answer: Answer,
) -> None:
    """Measure the twist of a recorded motion about an axis, with swing-twist angle, solid angle and error estimates.

    Columns are found by their headers, in any case and order: t or time, with a unit in brackets; qw qx qy qz or W X Y
    Z; r11 ... r33; angles with --euler. --relative-to, --relative-columns or --relative-body measure the twist of a
    joint, relative to a second sensor. Writes NetCDF and a figure; prints a summary, or with --json its numbers in SI
    units. Exits with status 3 if the data cannot be used.
    """
    require_readable(Path(data), "a recording")
    second = relative_to or (data if relative_columns or relative_body else None)
    none = "there is no second sensor: --relative-to FILE"
    refuse(
        (order not in (2, 4), "--order", f"{order} is neither 2 nor 4"),
        (decimal_comma and not csv, "--decimal-comma", "applies to CSV only; add --csv"),
    )
    target = _named(out) if out is not None else Path(f"{'stdin' if data == '-' else Path(data).stem}-twist")
    suffixes = (".nc", *[".csv"] * csv, *[".pdf", ".png"] * figure)
    places = {suffix: target.with_name(target.name + suffix) for suffix in suffixes}
    read = [Path(one) for one in (data, relative_to) if one is not None and Path(one).exists()]
    for place in places.values():
        is_read = place.exists() and any(place.samefile(one) for one in read)
        refuse((is_read, "--out", f"{place} is the recording itself; choose another name"))
    require_free(*places.values(), force=answer.force)
    with about(f"cannot read {data}", OSError), about(data, ValueError):
        motion = nontwist.read_motion(sys.stdin if data == "-" else data, **vars(reading))
    refuse(
        (second is None and relative_options is not None, "--relative-options", none),
        (second is None and clocks, "--clocks", none),
        (second is None and shake, "--shake", none),
        (static is not None and align is None, "--static", "requires --align static"),
        (second == "-", "--relative-to", "standard input is read once; save it in a file"),
    )
    other = None
    if second is not None:
        own = dict(vars(reading)) if relative_options is None else read_otherwise(ctx, second, relative_options)
        own |= {"columns": names_of(relative_columns), "body": relative_body}
        with about(f"cannot read {second}", OSError), about(second, ValueError), _of_second(second, relative_options):
            other = nontwist.read_motion(second, **own)
    is_run = (
        "orientation: a run of this package" in motion.attrs["notes"] and other is None and reading == ReadOptions()
    )
    with about(data, ValueError):
        result = nontwist.twist(
            nontwist.open_run(data) if is_run else motion,  # which knows its twist between the states
            axis=axis,
            axis_frame=axis_frame,
            relative_to=other,
            clocks=clocks or (None if relative_to else "shared"),
            shake=[numbers_of(one, TIMES, "--shake") for one in shake] if shake else None,
            align=align,
            static=None if static is None else numbers_of(static, TIMES, "--static"),
            order=4 if order == 4 else 2,
        )
    result.attrs["read"] = motion.attrs["notes"]
    if other is not None:
        result.attrs["relative_to"] = f"{second}: {other.attrs['notes']}"
    del motion, other  # makes room: the file is made in memory
    _write(result, places, degrees, decimal_comma, answer.force)
    if answer.in_words({"file": data, **facts(result)}):
        summary(result, degrees)
    is_shown = "twist_rate" in result and axis_frame == "body"  # with times
    answer.written(places.values(), *[("view", places[".nc"])] * is_shown)


def _named(out: Path) -> Path:
    """Return the name of the results without its suffix, which is .nc or none."""
    if looks_like_a_file(out) and out.suffix.lower() != ".nc":
        more = {".csv": "; --csv adds the curves", ".pdf": " and draws it", ".png": " and draws it"}
        hint = f"--out {out.with_suffix('')} writes {out.with_suffix('.nc')}{more.get(out.suffix.lower(), '')}"
        raise typer.BadParameter(f"{out} names one file; {hint}", param_hint="--out")
    return out.with_suffix("") if out.suffix.lower() == ".nc" else out


@contextmanager
def _of_second(file: str, given: str | None) -> Iterator[None]:
    """Name the options of the second sensor; if none are given it has those of the first."""
    try:
        yield
    except InputError as error:
        own = ShellOptions(body="--relative-body", columns="--relative-columns")
        sentence = SENTENCES[error.code]
        is_shared = given is None and any(isinstance(one, Option) for one in error.fields.values())
        needs_more = "{option[" in sentence and not any(f"[{name}]" in sentence for name in ("body", "columns"))
        more = '; for the second sensor alone: --relative-options "..."' if is_shared or needs_more else ""
        raise CommandError(f"{file}: {error.worded(own)}{more}", BAD_DATA) from error


# What is written and printed of a result.


def facts(result: Dataset) -> dict[str, Any]:
    """Return the numbers of the summary, in rad, s, sr."""
    import numpy as np

    names = ("twist_angle", "error_estimate", "noise_estimate", "swing_twist_angle", "solid_angle", "path_length")
    facts: dict[str, Any] = {name: float(result[name].values[-1]) for name in names}
    angles = result["twist_angle"].values
    facts |= {"least_twist_angle": float(angles.min()), "greatest_twist_angle": float(angles.max())}
    if "twist_rate" in result:
        rate, time = result["twist_rate"].values, result["time"].values
        k, intervals = int(np.argmax(abs(rate))), np.diff(time)
        facts |= {"largest_twist_rate": float(rate[k]), "largest_twist_rate_time": float(time[k])}
        facts |= {"duration": float(time[-1] - time[0]), "median_interval": float(np.median(intervals))}
        facts["largest_interval"] = float(intervals.max())
    texts = {k: result.attrs[k] for k in ("read", "relative_to", "alignment") if result.attrs.get(k)}
    counts = {k: result.attrs[k] for k in ("samples", "samples_left_out", "largest_turn_between_samples")}
    return facts | counts | texts


def _write(result: Dataset, places: dict[str, Path], degrees: bool, decimal_comma: bool, force: bool) -> None:
    """Write what each suffix stands for."""
    from ..io.run_files import in_degrees, write_csv

    nontwist.save_run(result, places[".nc"], force=force)
    if ".csv" in places:
        curves = result.drop_vars("frame")
        with written(places[".csv"], force=force) as file:
            text = io.TextIOWrapper(file, encoding="utf-8", newline="")
            write_csv(in_degrees(curves) if degrees else curves, text, decimal_comma=decimal_comma)
            text.detach()
    if ".pdf" in places:
        plot = nontwist.plot
        left, right = plot.new_axes(columns=2, height=2.6, panels=2)
        plot.path(result, left)
        drawn = plot.twist_angle(result, right, swing=True, degrees=degrees)
        plot.save(drawn, places[".pdf"], places[".png"], force=force)


def summary(result: Dataset, degrees: bool) -> None:
    """Print the numbers of a result in words."""
    import numpy as np

    from ..recordings.motions import GAP

    scale, unit = (180 / np.pi, "°") if degrees else (1.0, " rad")

    def angle(x: float, spec: str = ".6g") -> str:
        return number_text(scale * x, spec) + unit

    found = facts(result)
    error, noise = found["error_estimate"], found["noise_estimate"]
    is_noisy = noise == noise  # there are enough samples
    either = max(error, noise if is_noisy else 0.0)
    errors = f"sampling ± {error_text(scale * error)}{unit}"
    time, grown = result["time"].values, np.diff(result["error_estimate"].values)
    k, intervals = int(np.argmax(grown)), np.diff(time)
    if grown[k] > MOST * error > 0 and intervals[k] > GAP * np.median(intervals):
        where = f"{time[k]:.6g} s" if "duration" in found else f"row {time[k]:g}"
        errors += f", nearly all of it from the gap at {where}"
    errors += f", noise ± {error_text(scale * _told(noise))}{unit}" if is_noisy else ""
    names = ("twist_angle", "least_twist_angle", "greatest_twist_angle", "solid_angle")
    psi, low, high, area = (_told(found[name], either) for name in names)
    wound = abs(psi) > np.pi or abs(psi + area) > np.pi
    modulo = f" (modulo {'360°' if degrees else '2π'})" if wound else ""
    rows = {
        "total twist": f"{angle(psi)} ({number_text(psi / (2 * np.pi), '.4g')} turns; {errors})",
        "range of the twist angle": f"{angle(low)} to {angle(high)}",
        "swing-twist angle": angle(_told(found["swing_twist_angle"])) + modulo,
        "solid angle of the path": f"{area:.6g} sr" + (f" ({angle(area, '.4g')})" if degrees else ""),
        "path length of the axis": angle(_told(found["path_length"])),
    }
    lost = found["samples_left_out"]
    samples = f"{found['samples']}" + (f", {lost} dropped" if lost else "")
    if "duration" in found:
        every, most = found["median_interval"], found["largest_interval"]
        rate, when = _told(found["largest_twist_rate"] * every) / every, found["largest_twist_rate_time"]
        level = result.attrs["noise_level"] / (np.sqrt(2) * every)  # of central differences
        told, number = "", number_text(scale * rate, ".6g")
        if level > ROUND_OFF:
            told = f"; noise of each rate ± {error_text(scale * level)}{unit}/s"
            least = error_place(scale * abs(rate)) - 5 if rate else 0  # 6 digits
            number = text_to_place(scale * rate, max(error_place(scale * level), least))
        rows["largest twist rate"] = f"{number}{unit}/s" + (f" at t = {when:.6g} s{told}" if rate else "")
        samples += f", {found['duration']:.6g} s, every {number_text(every, '.4g')} s (at most "
        samples += f"{number_text(most, '.4g')} s)"
    rows["samples"] = samples
    rows["largest turn between samples"] = angle(_told(found["largest_turn_between_samples"]), ".4g")
    texts = (result.attrs.get(name, "") for name in ("read", "relative_to", "alignment"))
    read, other, alignment = (re.split(r"; (?=\w+: )", text) for text in texts)
    both = [one for one in read if one.startswith("direction: ") and one in other]
    own, others = ([one for one in lines if one not in both] for lines in (read, other))
    notes = {"read as": own, "relative to": others, "both sensors": both, "alignment": alignment}
    rows |= {label: "\n".join(lines) for label, lines in notes.items() if any(lines)}
    if is_noisy:
        told = ", of the drift of a clock two" if " ppm" in result.attrs["alignment"] else ""
        of_noise = f"of noise, independent from sample to sample, one standard deviation{told}"
        rows["±"] = f"{of_noise}; of sampling, an estimate of the error"
    if "alignment" in rows:
        rows["alignment"] += "\nthe errors of the total twist do not include those of the alignment"
    print_rows(result.attrs["title"], rows)


def _told(angle: float, error: float = 0.0) -> float:
    """Return an angle to be printed: 0 where it is round-off, or far below its error."""
    return angle if abs(angle) >= max(ROUND_OFF, DIGITS * error) else 0.0


# `nontwist fit`: the inertia of what was thrown, or swings on a pivot.

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
GYROSCOPE = {
    **dict.fromkeys(("time_column", "time_unit", "rate"), ""),
    "columns": "Columns to use, separated by commas: [TIME,] 3 of the angular velocity.",
    "body": "Which of several sensors to use: a value of the column that names the sensor of each row, or the common "
    "beginning of its headers.",
}
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
    reading: Annotated[ReadOptions, GYROSCOPE],
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
    figure: Annotated[
        Path | None, Opt("Draw data, model, residuals and moments of the first recording: .pdf, .svg, .png.", "PATH")
    ] = None,
    answer: Answer,
) -> None:
    """Estimate the inertia of a body from recordings of its motion: moments, principal axes, 95 % intervals.

    The columns of the gyroscope are found by their headers: gx gy gz, gyr_x, Gyroscope x (rad/s). The interval between
    release and catch is found, or given with --from and --to. Free motion determines only ratios; on a pivot
    (--gravity), or with a rotor (--rotor), the inertia is found in kg m². Exits with status 3 if the recordings cannot
    be used, do not determine every number (the undetermined ones are then named), or are not explained by noise and
    model.
    """
    from ..plot.journals import require_places

    is_empty = first is not None and last is not None and first >= last
    refuse(
        (everything and (first is not None or last is not None), "--all", "--from and --to name a part"),
        ((first is None) != (last is None), "--from" if last is None else "--to", "--from and --to go together"),
        (is_empty, "--to", f"must be after --from, {first or 0:g}, got {last or 0:g}"),
        (len(data) > 1 and "-" in data, "FILE...", "standard input is read once, and alone"),
    )
    for one in data:
        require_readable(Path(one), "a recording")
    interval: Any = "all" if everything else None if first is None else (first, last)
    what: Any = [sys.stdin if one == "-" else one for one in data]
    words = (gravity, rotor, orientation, delay, misalignment, axis_scales, damping, constraint)
    acting = {name: settings(text, name) for name, text in zip(SETTINGS, words, strict=True)}
    how: Any = {"bias": bias, "scale": scale, "noise": noise, "loss": loss, "unit": unit, **acting}
    how |= {"physical": not unphysical, **{name: getattr(reading, name) for name in GYROSCOPE}}
    if out is not None:
        require_free(out, force=answer.force)
    if figure is not None:
        require_places(figure, force=answer.force)
    fit = nontwist.fit_inertia(what if len(what) > 1 else what[0], interval=interval, **how)
    if answer.in_words({"files": data, **fit.numbers()}):
        print_rows(f"inertia of {', '.join(data)}", fit.table())
    made = []
    if figure is not None:
        nontwist.plot.save(fit.plot(), figure, force=answer.force)
        made.append(figure)
    done = fit.is_explained and not fit.untold
    if out is not None and done:
        fit.problem().write(out, force=answer.force)
        made.append(out)
    if made:
        answer.written(made)
    if out is not None and not done:
        undetermined = "the recordings do not determine the inertia"
        why = undetermined if fit.untold else "the model does not explain the recordings"
        say(f"not written: {out}, because {why}", "red")
    if not done:
        raise typer.Exit(BAD_DATA)
