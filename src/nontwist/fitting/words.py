"""A fit in words and in plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.tensors import ENTRIES
from .measuring import IDEAL, PLACES, UNITS
from .quality import STRAY
from .telling import FEWEST, quantile

if TYPE_CHECKING:
    from .result import Fit

SCALES = {
    "": "free motion determines ratios only: moments are parts of their sum J1 + J2 + J3",
    "m": "neither mass nor distance of the centre is known: moments are J/(m|c|), about the pivot",
    "kg m²": "by the known moment of gravity; about the pivot",
}
ROTOR = "by the known momentum of the rotor; J of the body with the rotor held"
OPPOSITE = ", or opposite: a gyroscope does not determine the sign"


def _number(value: float, interval: Any) -> str:
    """Return a value with its interval, to the digits that it has."""
    if not np.isfinite(value):
        return "undetermined"
    low, high = interval
    if not np.isfinite(high - low):
        return f"{value:.4g}, without an interval"
    width = max((high - low) / 2, 1e-9 * abs(value), 1e-300)
    if 1e-3 < abs(value) < 1e4:
        digits = int(np.clip(np.ceil(-np.log10(width)) + 1, 2, 8))
        return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
    digits = int(np.clip(np.ceil(np.log10(abs(value) / width)) + 1, 1, 8)) if value else 1
    return f"{value:.{digits}e} ({low:.{digits}e} to {high:.{digits}e})"


def _vector(v: Any) -> str:
    return f"({', '.join(f'{x:.4f}' for x in v)})"


def _rotor(fit: Fit) -> str:
    """Return what is known of the rotor."""
    model, speeds = fit.solution.problem.model, fit.solution.unknowns.speeds
    momentum = abs(speeds).max() * model.wheel.inertia  # type: ignore[union-attr]
    noise = max(one.speed.noise for one in fit.solution.problem.stretches if one.speed is not None)
    factor = f", times {model.factor(fit.solution.unknowns.more):.5f}" if "factor" in model.places else ""
    axis, tilt = fit.rotor_axis
    about = f" about {_vector(axis)} ± {np.degrees(tilt):.2g}°" if "axis" in model.places else ""
    return f"momentum up to {momentum:.4g} kg m² s⁻¹{about}{factor}; noise of its speed {noise:.3g} rad/s"


def _errors(fit: Fit) -> dict[str, str]:
    """Return rows of the errors of the gyroscope that are given or fitted."""
    found = {}
    sensor = fit.solution.problem.gyroscope
    for name, place in PLACES.items():
        if np.array_equal(sensor.mean[place], IDEAL[place]) and not sensor.deviation[place].any():
            continue
        value, intervals = getattr(fit, name)
        each = [
            _number(x, limits) if np.isfinite(limits).all() else f"{x:.4g} (undetermined)"
            for x, limits in zip(np.atleast_1d(value), np.atleast_2d(intervals), strict=True)
        ]
        if not sensor.deviation[place].any():
            each = [f"{x:.6g}" for x in np.atleast_1d(value)]
        given = "" if sensor.deviation[place].any() else ", as given"
        found[name.replace("_", " ")] = f"{', '.join(each)} {UNITS[name]}".rstrip() + given
    return found


def rows(fit: Fit) -> dict[str, str]:
    """Return the table of a fit."""
    found, model = fit.principal, fit.solution.problem.model
    of = {"": " / sum", "m": " / (m|c|)", "kg m²": ""}[fit.unit]
    unit = f" {fit.unit}" if fit.unit else ""
    told = {}
    if model.constraint is not None:  # its motion is one of the entries in the axes of the sensor, not of moments
        errors = quantile(fit.solution) * np.sqrt(fit.covariance.diagonal())
        for name, (i, j), error in zip(("xx", "yy", "zz", "yz", "xz", "xy"), ENTRIES, errors, strict=True):
            J = float(fit.inertia[i, j])
            told[f"J{name}{of}"] = _number(J, (J - error, J + error)) + unit * bool(np.isfinite(J))
    for k in () if model.constraint is not None else range(3):
        text = _number(found.moments[k], found.intervals[k])
        told[f"J{k + 1}{of}"] = text + unit * bool(np.isfinite(found.moments[k]))
    if model.constraint is None:
        told |= {f"J{k + 1} / J3": _number(found.ratios[k], found.ratio_intervals[k]) for k in range(2)}
        for k in range(3):
            axis, tilt = found.axes[:, k], found.tilts[k]
            text = f"{_vector(axis)} ± {np.degrees(tilt):.2g}°" if np.isfinite(tilt) else "undetermined"
            told[f"axis {k + 1}"] = text
    told["intervals"] = "95 %"
    told["scale"] = ROTOR if model.wheel is not None and model.pivot is None else SCALES[fit.unit]
    if model.pivot is not None:
        n, tilt = fit.centre
        how = f" ± {np.degrees(tilt):.2g}°{OPPOSITE}" if "centre" in model.places else ", as given"
        told["centre of mass"] = f"along {_vector(n)}{how}"
    if model.constraint is not None:
        held = _vector(model.constraint)
        told["constraint"] = f"W·n = 0, n = {held}; the moment of inertia about n does not affect the motion"
    if model.wheel is not None:
        told["rotor"] = _rotor(fit)
    if model.damping or model.damped is not None:
        C, intervals = fit.damping
        values = [_number(C[k], intervals[k]) for k in range(max(model.damping, 1))]
        per = {"": "s⁻¹, of the sum of the moments", "m": "m/s, of m|c|", "kg m²": "N m s"}[fit.unit]
        told["damping"] = f"{', '.join(values)} {per}" if model.damping else f"{_vector(C)} N m s, as given"
    if fit.untold:
        told["undetermined"] = "; ".join(one.name for one in fit.untold) + "; turn it about a second axis"
    if fit.has_gyroscope:
        told["bias"] = f"{_vector(fit.bias)} rad/s"
        told["gyroscope scale"] = f"{fit.scale:.5f}"
        told |= _errors(fit)
    white = "white" if fit.is_white else f"not white: the intervals {_wide(fit)}"
    if fit.solution.memory and fit.solution.effective_samples < FEWEST:
        white = f"so slow that {fit.solution.effective_samples:.2g} samples count: no intervals"
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


def numbers(fit: Fit) -> dict[str, Any]:
    """Return the numbers of a fit; None where the data do not tell."""
    found = fit.principal

    def plain(value: Any) -> Any:
        if isinstance(value, (list, tuple)):
            return [plain(one) for one in value]
        return value if np.isfinite(value) else None

    model = fit.solution.problem.model
    beside: dict[str, Any] = {}
    if model.pivot is not None:
        beside = {"centre_direction": fit.centre[0].tolist(), "centre_tilt": plain(fit.centre[1])}
    if model.wheel is not None:
        beside |= {"rotor_factor": model.factor(fit.solution.unknowns.more)}
        beside |= {"rotor_axis": fit.rotor_axis[0].tolist(), "rotor_axis_tilt": plain(fit.rotor_axis[1])}
    if model.damping or model.damped is not None:
        beside |= {"damping": fit.damping[0].tolist(), "damping_intervals": plain(fit.damping[1].tolist())}
    for name in PLACES if fit.has_gyroscope else ():
        value, intervals = getattr(fit, name)
        beside |= {name: np.asarray(value).tolist(), f"{name}_interval": plain(np.asarray(intervals).tolist())}
    return {
        "unit": fit.unit,
        "moments": plain(found.moments.tolist()),
        "intervals": plain(found.intervals.tolist()),
        "ratios": plain(found.ratios.tolist()),
        "ratio_intervals": plain(found.ratio_intervals.tolist()),
        "axes": found.axes.T.tolist(),
        "tilts": plain(found.tilts.tolist()),
        "inertia": plain(fit.inertia.tolist()),
        "covariance": plain(fit.covariance.tolist()),
        "identifiable": [
            {"name": one.name, "standard_error": plain(one.standard_error), "is_told": one.is_told}
            for one in fit.identifiable
        ],
        **beside,
        "bias": fit.bias.tolist() if fit.has_gyroscope else None,
        "gyroscope_scale": fit.scale if fit.has_gyroscope else None,
        "noise": fit.noise if fit.has_gyroscope else None,
        "attitude_noise": plain(fit.attitude_noise),
        "correlation": fit.correlation,
        "is_white": bool(fit.is_white),
        "misfit": fit.misfit,
        "is_explained": bool(fit.is_explained),
        "cross_validation": fit.cross_validation.tolist(),
        "recordings": [
            {
                "name": part.name,
                "samples": len(part.time),
                "from": float(part.time[0]),
                "to": float(part.time[-1]),
                "interval": part.interval,
                "left_out": part.left_out,
                "read": "; ".join(part.notes),
            }
            for part in fit.parts
        ],
        "warnings": list(fit.warnings),
    }


def worth(fit: Fit) -> list[str]:
    """Return what is to be said of a fit."""
    said = []
    if fit.untold:
        said.append(
            f"the recording does not determine {' nor '.join(one.name for one in fit.untold)}: turn the body about a "
            "second axis, or longer"
        )
    size = abs(fit.residual)
    typical = float(np.median(size) / 0.6745)
    row, axis = (int(i) for i in np.unravel_index(int(np.argmax(size)), size.shape))
    if size[row, axis] > STRAY * typical and fit.solution.problem.loss == "linear":
        time = np.concatenate([part.time for part in fit.parts])
        said.append(
            f"a sample at t = {time[row]:.6g} s is {size[row, axis] / typical:.3g} times the noise off: an impact? "
            "--loss soft_l1 (loss=) counts single samples less, --from and --to (interval=) leave a part out"
        )
    if not fit.is_explained:
        said.append(
            f"the residuals are {fit.misfit:.3g} times what noise explains: neither the inertia nor its intervals are "
            "to be trusted. Are hands or impacts in it (--from and --to, interval=), does more act on the body "
            "(--damping, damping=), does a part move, is the mass, the centre or the unit wrong? Where the sensor is "
            "off by as much, --noise (noise=) states it"
        )
    elif not fit.is_white:
        said.append(
            f"the residuals are not white (correlation of neighbours {fit.correlation:.2f}): the intervals "
            f"{_wide(fit)}; its noise is slow, the sensor filters, something moves in the body, or the air acts "
            "(--damping, damping=)"
        )
    return said


def _wide(fit: Fit) -> str:
    return "allow for it" if fit.solution.memory else "are too narrow"
