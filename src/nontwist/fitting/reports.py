"""A fit in words, in plain data, as a figure, and as a run file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SENTENCES, InputWarning
from ..geometry.arrays import Axes
from ..geometry.attitudes import ENTRIES
from ..io.run_files import finite
from .estimating import UNLIKELY
from .measuring import IDEAL, PLACES, UNITS
from .shooting import STRAY
from .telling import has_intervals, quantile

if TYPE_CHECKING:
    from .result import Fit, Part

SCALES = {
    "": "free motion determines ratios only: moments are parts of their sum J1 + J2 + J3",
    "m": "neither mass nor distance of the centre is known: moments are J/(m|c|), about the pivot",
    "kg m²": "by the known moment of gravity; about the pivot",
}
ROTOR = "by the known momentum of the rotor; J of the body with the rotor held"
OPPOSITE = ", or opposite: a gyroscope does not determine the sign"
DAMPING = {"": "s⁻¹, of the sum of the moments", "m": "m/s, of m|c|", "kg m²": "N m s"}
QUALITY = (
    "attitude_noise",
    "correlation",
    "effective_samples",
    "is_white",
    "misfit",
    "is_explained",
    "cross_validation",
)
ROUND_OFF = 1e-12  # of the largest number that is fitted: no residual tells anything that is less
SHARE = 0.5  # of the second moments along the centre: what an unknown mass takes of them


def _number(value: float, interval: Any, unit: str = "") -> str:
    """Return a value with its interval, to the digits that it has, and its unit."""
    if not np.isfinite(value):
        return "undetermined"
    low, high = interval
    if not np.isfinite(high - low):
        return f"{value:.4g}, without an interval{unit}"
    width = max((high - low) / 2, 1e-9 * abs(value), 1e-300)
    if 1e-3 < abs(value) < 1e4:
        form = f".{int(np.clip(np.ceil(-np.log10(width)) + 1, 2, 8))}f"
    else:
        form = f".{int(np.clip(np.ceil(np.log10(abs(value) / width)) + 1, 1, 8)) if value else 1}e"
    return f"{value:{form}} ({low:{form}} to {high:{form}}){unit}"


def _vector(v: Any) -> str:
    return f"({', '.join(f'{x:.4f}' for x in v)})"


def _direction(v: Any, tilt: float) -> str:
    """Return a direction with the half-width of its interval, rad."""
    return f"{_vector(v)} ± {np.degrees(tilt):.2g}°" if np.isfinite(tilt) else f"{_vector(v)}, without an interval"


def rows(fit: Fit) -> dict[str, str]:
    """Return the table of a fit."""
    found, model, at = fit.principal, fit.solution.problem.model, fit.solution.unknowns
    of, unit = {"": " / sum", "m": " / (m|c|)", "kg m²": ""}[fit.unit], f" {fit.unit}" if fit.unit else ""
    told = {}
    if model.constraint is not None:  # its motion is one of the entries in the axes of the sensor, not of moments
        errors = quantile(fit.solution) * np.sqrt(fit.covariance.diagonal())
        for name, (i, j), error in zip(("xx", "yy", "zz", "yz", "xz", "xy"), ENTRIES, errors, strict=True):
            J = float(fit.inertia[i, j])
            told[f"J{name}{of}"] = _number(J, (J - error, J + error), unit)
    else:
        for k in range(3):
            told[f"J{k + 1}{of}"] = _number(found.moments[k], found.intervals[k], unit)
        for k in range(2):
            told[f"J{k + 1} / J3"] = _number(found.ratios[k], found.ratio_intervals[k])
        for k, (axis, tilt) in enumerate(zip(found.axes.T, found.tilts, strict=True)):
            is_lost = np.isnan(tilt) and has_intervals(fit.solution)
            told[f"axis {k + 1}"] = "undetermined" if is_lost else _direction(axis, tilt)
    told["intervals"] = "95 %"
    told["scale"] = ROTOR if model.wheel is not None and model.pivot is None else SCALES[fit.unit]
    if model.pivot is not None:
        n, tilt = fit.centre
        is_fitted = "centre" in model.places
        told["centre of mass"] = f"along {_direction(n, tilt) + OPPOSITE if is_fitted else _vector(n) + ', as given'}"
    if model.constraint is not None:
        held = _vector(model.constraint)
        told["constraint"] = f"W·n = 0, n = {held}; the moment of inertia about n does not affect the motion"
    if model.wheel is not None:
        axis, tilt = fit.rotor_axis
        about = f" about {_direction(axis, tilt)}" if "axis" in model.places else ""
        factor = f", times {model.factor(at.more):.5f}" if "factor" in model.places else ""
        noise = max(one.speed.noise for one in fit.solution.problem.stretches if one.speed is not None)
        momentum = f"momentum up to {abs(at.speeds).max() * model.wheel.inertia:.4g} kg m² s⁻¹{about}{factor}"
        told["rotor"] = f"{momentum}; noise of its speed {noise:.3g} rad/s"
    if model.is_damped:
        C, intervals = fit.damping
        values = ", ".join(_number(C[k], intervals[k]) for k in range(max(model.damping, 1)))
        told["damping"] = f"{values} {DAMPING[fit.unit]}" if model.damping else f"{_vector(C)} N m s, as given"
    if fit.untold:
        told["undetermined"] = "; ".join(one.name for one in fit.untold) + "; turn it about a second axis"
    if fit.has_gyroscope:
        told |= {"bias": f"{_vector(fit.bias)} rad/s", "gyroscope scale": f"{fit.scale:.5f}"}
        told |= {name.replace("_", " "): text for name in PLACES if (text := _error(fit, name))}
    white = "white" if fit.is_white else f"not white: {_wide(fit)}"
    if not fit.is_explained:
        white = f"{fit.misfit:.3g} times the noise: not to be trusted"
    size = [f"{fit.noise:.3g} rad/s"] * fit.has_gyroscope + [f"{np.degrees(fit.attitude_noise):.3g}°"] * model.oriented
    told["residual"] = f"{' and '.join(size)}, correlation of neighbours {fit.correlation:.2f}, {white}"
    for part in fit.parts:
        lost = f", {part.left_out} rows dropped" if part.left_out else ""
        told[part.name] = (
            f"{len(part.time)} samples, t = {part.time[0]:.6g} s to {part.time[-1]:.6g} s ({part.interval}){lost}"
        )
    if len(fit.parts) > 1:
        ratios = ", ".join(f"{ratio:.3g}" for ratio in fit.cross_validation)
        told["cross-validation"] = (
            f"residual of each recording with the inertia of the others, relative to the expected residual: {ratios}"
        )
    return told


def _error(fit: Fit, name: str) -> str:
    """Return an error of the gyroscope that is given or fitted; empty where there is none."""
    place, gyroscope = PLACES[name], fit.solution.problem.gyroscope
    value, intervals = getattr(fit, name)
    if not gyroscope.deviation[place].any():
        if np.array_equal(gyroscope.mean[place], IDEAL[place]):
            return ""
        return f"{', '.join(f'{x:.6g}' for x in np.atleast_1d(value))} {UNITS[name]}".rstrip() + ", as given"
    each = [
        _number(x, limits) if np.isfinite(limits).all() else f"{x:.4g} (undetermined)"
        for x, limits in zip(np.atleast_1d(value), np.atleast_2d(intervals), strict=True)
    ]
    return f"{', '.join(each)} {UNITS[name]}".rstrip()


def numbers(fit: Fit) -> dict[str, Any]:
    """Return the numbers of a fit; None where the data do not tell."""
    found, model, seen = fit.principal, fit.solution.problem.model, fit.has_gyroscope
    told: dict[str, Any] = {
        "unit": fit.unit,
        **{name: getattr(found, name) for name in ("moments", "intervals", "ratios", "ratio_intervals")},
        "axes": found.axes.T,
        "tilts": found.tilts,
        "inertia": fit.inertia,
        "covariance": fit.covariance,
        "identifiable": [
            {"name": one.name, "standard_error": one.standard_error, "is_told": one.is_told} for one in fit.identifiable
        ],
    }
    if model.pivot is not None:
        told["centre_direction"], told["centre_tilt"] = fit.centre
    if model.wheel is not None:
        told["rotor_factor"] = model.factor(fit.solution.unknowns.more)
        told["rotor_axis"], told["rotor_axis_tilt"] = fit.rotor_axis
    if model.is_damped:
        told["damping"], told["damping_intervals"] = fit.damping
    for name in PLACES if seen else ():
        told[name], told[f"{name}_interval"] = getattr(fit, name)
    told |= {
        "bias": fit.bias if seen else None,
        "gyroscope_scale": fit.scale if seen else None,
        "noise": fit.noise if seen else None,
        **{name: getattr(fit, name) for name in QUALITY},
        "recordings": [
            {
                "name": part.name,
                "samples": len(part.time),
                "from": part.time[0],
                "to": part.time[-1],
                "interval": part.interval,
                "left_out": part.left_out,
                "read": "; ".join(part.notes),
            }
            for part in fit.parts
        ],
        "warnings": fit.warnings,
    }
    return finite(told)


SENTENCES |= {
    "undetermined": "the recording does not determine {names}: turn the body about a second axis, or longer",
    "unsettled": "the fit ended before it settled, in a long valley: neither inertia nor intervals are to be trusted; "
    "a longer motion, or one about another axis, tells more",
    "stray": "a sample at t = {time:.6g} s is {times:.3g} times the noise off: an impact? {option[loss='soft_l1']} "
    "counts single samples less, {option[interval]} can leave a part out",
    "unexplained": "the residuals are {misfit:.3g} times what noise explains: neither the inertia nor its intervals "
    "are to be trusted. Are hands or impacts in it ({option[interval]}), does more act on the body "
    "({option[damping]}), does a part move, is the mass, the centre or the unit wrong? Where the sensor is off by as "
    "much, {option[noise]} states it",
    "not-white": "the residuals are not white (correlation of neighbours {correlation:.2f}): {wide}; its noise is "
    "slow, the sensor filters, something moves in the body, or the air acts ({option[damping]})",
    "unlikely-error": "an error of the gyroscope is {times:.3g} times its standard deviation: if it may be so large, "
    "state it ({option[bias]}, {option[scale]}); if not, the inertia is not to be trusted",
}


def worth(fit: Fit) -> list[InputWarning]:
    """Return what is to be said of a fit."""
    said = []
    if fit.untold:
        said.append(InputWarning("undetermined", names=" nor ".join(one.name for one in fit.untold)))
    if not (fit.solution.is_settled or fit.untold):
        said.append(InputWarning("unsettled"))
    size = abs(fit.residual)
    round_off = ROUND_OFF * max(float(abs(part.model).max()) for part in fit.parts)
    typical = max(float(np.median(size) / 0.6745), fit.stated_noise, round_off)
    row, axis = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    if size[row, axis] > STRAY * typical and fit.solution.problem.loss == "linear":
        time = np.concatenate([part.time for part in fit.parts])
        said.append(InputWarning("stray", time=time[row], times=size[row, axis] / typical))
    if not fit.is_explained:
        said.append(InputWarning("unexplained", misfit=fit.misfit))
    elif not fit.is_white:
        said.append(InputWarning("not-white", correlation=fit.correlation, wide=_wide(fit)))
    elif fit.solution.unlike > UNLIKELY:
        said.append(InputWarning("unlikely-error", times=fit.solution.unlike))
    return said


def _wide(fit: Fit) -> str:
    if has_intervals(fit.solution):
        return "the intervals allow for it"
    return f"only {fit.effective_samples:.2g} of {fit.residual.size} samples count: no intervals"


def drawn(fit: Fit, recording: int) -> Axes:
    """Draw data and model, residuals, and principal moments with their intervals; return the first axes."""
    from ..plot.journals import new_axes, style
    from ..plot.looks import cycle

    part, found = fit.parts[recording], fit.principal
    first = sum(len(one.time) for one in fit.parts[:recording])
    told = f"data and model: {Path(part.name).name}" if len(fit.parts) > 1 else "data and model"
    rest = fit.residual[first : first + len(part.time)]
    with style():
        data, left_over, moments = new_axes(columns=2, height=2.6, panels=3)
        for k, name in enumerate("xyz"):
            colour = cycle()[k]["color"]
            data.plot(part.time, part.measured[:, k], ".", color=colour, markersize=2)
            data.plot(part.time, part.model[:, k], "-", color=colour, linewidth=0.8, label=name)
            left_over.plot(part.time, rest[:, k], ".", color=colour, markersize=2)
        data.set(xlabel="time $t$ (s)", ylabel="angular velocity (rad s$^{-1}$)", title=told)
        low, high = data.get_ylim()
        data.set_ylim(low, high + 0.15 * (high - low))  # room for the legend
        data.legend(loc="upper left", ncols=3, handlelength=1.2, columnspacing=0.8)
        for level in (-2, 2):
            left_over.axhline(level * fit.noise, color="0.5", linewidth=0.6, linestyle="--")
        unit = "rad s$^{-1}$" if fit.has_gyroscope else "rad"
        left_over.set(xlabel="time $t$ (s)", ylabel=f"residual ({unit})", title="residual and 2 σ")
        is_told = np.isfinite(found.moments)
        shown, value = np.flatnonzero(is_told), found.moments[is_told]
        errors = abs(found.intervals[is_told].T - value)
        moments.errorbar(shown + 1, value, errors, fmt="o", markersize=3, capsize=4, color="0.1")
        how: dict[str, Any] = {"ha": "center", "va": "center", "rotation": 90, "color": "0.4"}
        for place in (1 + np.flatnonzero(~is_told)).tolist():
            moments.text(place, 0.45, "undetermined", transform=moments.get_xaxis_transform(), **how)
        top, label = 0.56, "moment / sum; dotted: flat bodies"
        if fit.unit:
            top = 1.1 * max([fit.size / 3, *found.intervals[shown, 1]])
            label = "moment (kg m$^2$)" if fit.unit == "kg m²" else "moment / (m|c|) (m)"
        else:
            moments.axhline(0.5, color="0.5", linewidth=0.6, linestyle=":")
        moments.set(xlim=(0.5, 3.5), ylim=(0, top), xticks=[1, 2, 3], title="principal moments")
        moments.set(xlabel="axis", ylabel=label)
    return data


def as_run(fit: Fit, part: Part) -> dict[str, Any]:
    """Return the tables of a run file of the motion of one recording."""
    from scipy.spatial.transform import Rotation

    from ..models.bodies import heavy_top, standard, suslov

    model, more = fit.solution.problem.model, fit.solution.unknowns.more
    said = "the rotor is a load" if model.wheel is not None else "moments of inertia in parts of their sum"
    J, W, n = fit.solution.unknowns.inertia * fit.size, part.start, model.constraint
    any_J: Any = {} if model.physical else {"physical": False}
    body: dict[str, Any] = {"kind": standard.__name__, "inertia": J.tolist(), **any_J}
    if n is not None:
        body |= {"kind": suslov.__name__, "axis": n.tolist()}
        W = W - n * (n @ W)
    start: dict[str, Any] = {"angular_velocity": {"body": W.tolist()}}
    if len(part.attitude):
        start["rotation"] = {"matrix": Rotation.from_quat(part.attitude).as_matrix().tolist()}
    if model.pivot is not None:
        c, _ = fit.centre
        mass, distance, said = model.pivot.mass, model.pivot.distance, "the heading at the start is arbitrary"
        if mass is None:  # m |c| = 1 kg m, |c| so short that a body has these second moments
            distance = SHARE / float(c @ np.linalg.solve(np.trace(J) / 2 * np.eye(3) - J, c))
            mass, said = 1 / distance, "moments of inertia in units of m|c|; " + said
        body |= {"mass": mass, "centre_of_mass": (distance * c).tolist(), "gravity": [0.0, 0.0, -model.pivot.gravity]}
        if n is None:
            body["kind"] = heavy_top.__name__
        upright, _ = Rotation.align_vectors([0, 0, -1], part.down)
        start["rotation"] = {"matrix": upright.as_matrix().tolist()}
    if n is not None:
        said += "; the moment of inertia about the constrained axis is arbitrary"
    run: dict[str, Any] = {"title": f"Motion as fitted; {said}", "body": body, "start": start}
    run["time"] = {"t_start": float(part.time[0]), "t_end": float(part.time[-1])}
    loads: list[dict[str, Any]] = []
    if (C := np.maximum(fit.damping[0], 0.0)).any():  # what drives the body is no damping
        loads.append({"kind": "damping", "coefficient": C.tolist()})
    if model.wheel is not None and part.speed is not None:
        momentum = model.wheel.inertia * model.factor(more) * part.speed[1]
        table = {"times": part.speed[0].tolist(), "values": momentum.tolist()}
        loads.append({"kind": "rotor", "axis": model.axis(more).tolist(), **table})
    return run | ({"load": loads} if loads else {})
