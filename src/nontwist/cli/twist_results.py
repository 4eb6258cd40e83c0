"""What `nontwist twist` writes and prints of a result."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .summaries import print_rows

if TYPE_CHECKING:
    import xarray

ROUND_OFF = 1e-14  # rad
MOST = 0.9  # of an error: what makes more is named as its cause
DIGITS = 1e-2  # of its error: a number below it has no digit that means anything


def facts(result: xarray.Dataset) -> dict[str, Any]:
    """Return the numbers of the summary, in rad, s, sr."""
    import numpy as np

    names = ("twist_angle", "error_estimate", "noise_estimate", "swing_twist_angle", "solid_angle", "path_length")
    facts: dict[str, Any] = {name: float(result[name].values[-1]) for name in names}
    if np.isnan(facts["noise_estimate"]):  # too few samples
        facts["noise_estimate"] = None
    angles = result["twist_angle"].values
    facts |= {"least_twist_angle": float(angles.min()), "greatest_twist_angle": float(angles.max())}
    if "twist_rate" in result:
        rate, time = result["twist_rate"].values, result["time"].values
        k, intervals = int(np.argmax(abs(rate))), np.diff(time)
        facts |= {"largest_twist_rate": float(rate[k]), "largest_twist_rate_time": float(time[k])}
        facts |= {"duration": float(time[-1] - time[0])}
        facts |= {"median_interval": float(np.median(intervals)), "largest_interval": float(intervals.max())}
    texts = {k: result.attrs[k] for k in ("read", "relative_to", "alignment") if result.attrs.get(k)}
    counts = {k: result.attrs[k] for k in ("samples", "samples_left_out", "largest_turn_between_samples")}
    return facts | counts | texts


def write(result: xarray.Dataset, places: dict[str, Path], *, degrees: bool, decimal_comma: bool, force: bool) -> None:
    """Write what each suffix stands for."""
    from ..io import save_run
    from ..io.whole import written

    save_run(result, places[".nc"], force=force)
    if ".csv" in places:
        from ..io.exports import in_degrees, write_csv

        curves = result.drop_vars("frame")
        with written(places[".csv"], force=force) as file:
            text = io.TextIOWrapper(file, encoding="utf-8", newline="")
            write_csv(in_degrees(curves) if degrees else curves, text, decimal_comma=decimal_comma)
            text.detach()
    if ".pdf" in places:
        from .. import plot

        left, right = plot.new_axes(columns=2, height=2.6, panels=2)
        plot.path(result, left)
        drawn = plot.twist_angle(result, right, swing=True, degrees=degrees)
        plot.save(drawn, places[".pdf"], places[".png"], force=force)


def summary(result: xarray.Dataset, degrees: bool) -> None:
    """Print the numbers of a result in words."""
    import numpy as np

    from ..geometry.values import error_place, error_text, number_text, text_to_place
    from ..recordings.motions import GAP

    scale, unit = (180 / np.pi, "°") if degrees else (1.0, " rad")

    def angle(x: float, spec: str = ".6g") -> str:
        return number_text(scale * x, spec) + unit

    found = facts(result)
    error, noise = found["error_estimate"], found["noise_estimate"]
    either = max(error, noise or 0.0)
    errors = f"sampling ± {error_text(scale * error)}{unit}"
    time, grown = result["time"].values, np.diff(result["error_estimate"].values)
    k, intervals = int(np.argmax(grown)), np.diff(time)
    if grown[k] > MOST * error > 0 and intervals[k] > GAP * np.median(intervals):
        where = f"{time[k]:.6g} s" if "duration" in found else f"row {time[k]:g}"
        errors += f", nearly all of it from the gap at {where}"
    errors += "" if noise is None else f", noise ± {error_text(scale * _told(noise))}{unit}"
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
    notes = {
        label: re.split(r"; (?=\w+: )", result.attrs[name])
        for label, name in (("read as", "read"), ("relative to", "relative_to"), ("alignment", "alignment"))
        if result.attrs.get(name)
    }
    both = [
        one for one in notes.get("read as", ()) if one.startswith("direction: ") and one in notes.get("relative to", ())
    ]
    for label, lines in notes.items():
        rows[label] = "\n".join(one for one in lines if one not in both)
        if both and label == "relative to":
            rows["both sensors"] = "\n".join(both)
    if noise is not None:
        told = ", of the drift of a clock two" if " ppm" in result.attrs["alignment"] else ""
        rows["±"] = f"of noise one standard deviation{told}; of sampling, an estimate of the error"
    if "alignment" in rows:
        rows["alignment"] += "\nthe errors of the total twist do not include those of the alignment"
    print_rows(result.attrs["title"], rows)


def _told(angle: float, error: float = 0.0) -> float:
    """Return an angle to be printed: 0 where it is round-off, or far below its error."""
    return angle if abs(angle) >= max(ROUND_OFF, DIGITS * error) else 0.0
