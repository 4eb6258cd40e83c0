"""How good are the intervals of `fit_inertia`? Throws of known bodies, recorded by a simulated gyroscope, and fitted.

    python examples/fit_study.py --recordings 1000

Each throw lasts 0.6 s. The gyroscope has white noise of 1.2e-4 rad/s/√Hz (0.007 °/s/√Hz), a bias of 0.02 rad/s along
each axis and a scale that is off by 1 %, both drawn from normal distributions, which are the priors of the fit; half of
the recordings are at 100 Hz and half at 400 Hz. Every other body is a phone, 147 × 72 × 8 mm, mounted with an error of
3°; the others are boxes with random sides, in random axes. The directions of the angular velocities are uniform on the
sphere, their sizes are 6 to 20 rad/s.

The bound of Cramér and Rao is that of the model at the truth, with the priors. A throw counts as telling where the
bound of all three moments is below 3 %.

    python examples/fit_study.py --recordings 200 --model pendulum

Boxes on a pivot 5 to 20 cm from their centres of mass, let go in a random attitude with 2 to 8 rad/s, recorded for
1.5 s by the same gyroscope. The mass is known, and of every other recording the centre of mass, of the others only its
distance from the pivot. The moments are in kg m².

    python examples/fit_study.py --recordings 200 --model wheel

Boxes in free flight for 1 s, with a wheel about a random axis that spins up from 100 to 200 rad/s and carries as much
momentum as the box. Its speed is recorded with an error of 1 rad/s a sample, and its inertia is known.

    python examples/fit_study.py --recordings 200 --model attitude

Boxes that are thrown, whose attitudes are recorded with a white error of 0.3° about each axis, as by markers and
cameras; every other one with the gyroscope as well.
"""

from __future__ import annotations

import argparse
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nontwist import fit_inertia, heavy_top, inertia, rotation, rotor, sensors, simulate, standard
from nontwist.fitting.estimating import whole, with_moments
from nontwist.fitting.measuring import as_speed, continuous, plain_gyroscope
from nontwist.fitting.shooting import Shooting, Stretch, Unknowns, residuals
from nontwist.fitting.solving import Solution
from nontwist.fitting.unknowns import Model, Pivot, Wheel, symmetric

SECONDS, DENSITY, BIAS, SCALE, BOUND, TILT = 0.6, 1.2e-4, 0.02, 0.01, 0.03, np.radians(0.3)


@dataclass(frozen=True)
class Case:
    """A recording, how it is fitted, and the truth: J, its unit, what is beside it, start, bias, scale, speed."""

    recording: Any
    how: dict[str, Any]
    model: Model
    inertia: Any
    more: Any
    start: Any
    bias: Any
    scale: float
    noise: float
    rate: int
    speed: Any = None
    tilt: float = 0.0


def sensed(run: Any, rng: Any, number: int) -> tuple[Any, Any, float, int]:
    """Return what the gyroscope reads of a run, its bias and scale, and its rate."""
    rate = (100, 400)[number // 2 % 2]
    bias, scale = BIAS * rng.normal(size=3), 1 + SCALE * rng.normal()
    how = {"noise": DENSITY, "bias": bias, "scale": scale, "rate": rate, "seed": number}
    return sensors.gyroscope(run, **how), bias, scale, rate


def drawn(rng: Any, low: float, high: float) -> Any:
    """Return a vector of a random direction and a length between two numbers."""
    direction = rng.normal(size=3)
    return rng.uniform(low, high) * direction / np.linalg.norm(direction)


def box(rng: Any, mass: float, sides: Any, turned: Rotation) -> Any:
    """Return the inertia of a box in turned axes."""
    J = turned.as_matrix() @ inertia.of_cuboid(mass, sides) @ turned.as_matrix().T
    return (J + J.T) / 2


def throw(number: int) -> Case:
    """Return a body that is thrown."""
    rng = np.random.default_rng([2026, number])
    is_phone = number % 2 == 0
    sides = (0.147, 0.072, 0.008) if is_phone else rng.uniform(0.05, 0.2, 3)
    turned = Rotation.from_rotvec(rng.normal(size=3) * np.radians(3)) if is_phone else Rotation.random(rng=rng)
    J = box(rng, 1.0, sides, turned)
    J /= np.trace(J)
    W = drawn(rng, 6, 20)
    run = simulate(standard(J), t_end=SECONDS, step=1 / 400, material_angular_velocity=W)
    recording, bias, scale, rate = sensed(run, rng, number)
    noise = DENSITY * np.sqrt(rate / 2)
    return Case(recording, {"interval": "all"}, Model(), J, np.zeros(0), W, bias, scale, noise, rate)


def pendulum(number: int) -> Case:
    """Return a body on a pivot."""
    rng = np.random.default_rng([2027, number])
    mass, c = rng.uniform(0.2, 1), drawn(rng, 0.05, 0.2)
    J = box(rng, mass, rng.uniform(0.05, 0.3, 3), Rotation.random(rng=rng))
    J += mass * (c @ c * np.eye(3) - np.outer(c, c))
    W, attitude = drawn(rng, 2, 8), Rotation.random(rng=rng)
    begin = {"rotation": attitude, "material_angular_velocity": W}
    run = simulate(heavy_top(J, mass, c), t_end=1.5, step=1 / 400, **begin)
    recording, bias, scale, rate = sensed(run, rng, number)
    far, known = float(np.linalg.norm(c)), number % 2 == 0
    gravity = {"mass": mass, "centre": c} if known else {"mass": mass, "distance": far}
    model = Model(Pivot(mass, far, c / far if known else None, 9.81), unit=float(np.trace(J)))
    more = np.zeros(0) if known else c / far
    start = np.concatenate([W, attitude.as_matrix().T @ [0, 0, -1]])
    noise = DENSITY * np.sqrt(rate / 2)
    return Case(recording, {"gravity": gravity}, model, J, more, start, bias, scale, noise, rate)


def wheel(number: int) -> Case:
    """Return a free body with a wheel that spins up."""
    rng = np.random.default_rng([2028, number])
    J = box(rng, 1.0, rng.uniform(0.05, 0.2, 3), Rotation.random(rng=rng))
    W, axis = drawn(rng, 4, 12), drawn(rng, 1, 1)
    I = float(np.trace(J) / 3 * np.linalg.norm(W) / 150)
    times = np.linspace(0, 1, 201)
    speeds = 100 + 100 * (1 - np.exp(-times / 0.4))
    run = simulate(standard(J), t_end=1, step=1 / 400, material_angular_velocity=W, load=rotor(axis, times, I * speeds))
    recording, bias, scale, rate = sensed(run, rng, number)
    t = recording.time.values
    readings = np.interp(t, times, speeds) + rng.normal(size=len(t))
    how = {"rotor": {"axis": axis, "inertia": I, "speed": 0.0}}
    model = Model(wheel=Wheel(axis, I, 0.0), unit=float(np.trace(J)))
    noise, what = DENSITY * np.sqrt(rate / 2), (t, recording.gyroscope.values, readings)
    speed = (times, speeds)
    return Case(what, how, model, J, np.zeros(0), W, bias, scale, noise, rate, speed)


def attitude(number: int) -> Case:
    """Return a free body whose attitudes are recorded."""
    rng = np.random.default_rng([2029, number])
    J = box(rng, 1.0, rng.uniform(0.05, 0.2, 3), Rotation.random(rng=rng))
    J /= np.trace(J)
    W, begin = drawn(rng, 6, 20), Rotation.random(rng=rng)
    run = simulate(standard(J), t_end=SECONDS, step=1 / 400, rotation=begin, material_angular_velocity=W)
    recording, bias, scale, rate = sensed(run, rng, number)
    times, noise = recording.time.values, DENSITY * np.sqrt(rate / 2)
    exact = rotation(run)[:: 400 // rate]
    read = exact * Rotation.from_rotvec(TILT * rng.normal(size=(len(times), 3)))
    what = (times, read) if number % 2 == 0 else (times, recording.gyroscope.values, read)
    start = np.concatenate([W, begin.as_quat()])
    model = Model(oriented=True)
    return Case(what, {"interval": "all"}, model, J, np.zeros(0), start, bias, scale, noise, rate, None, TILT)


MODELS = {"throw": throw, "pendulum": pendulum, "wheel": wheel, "attitude": attitude}


def samples(case: Case) -> tuple[Any, Any, Any]:
    """Return times, angular velocities, and speeds or attitudes."""
    if not isinstance(case.recording, tuple):
        return case.recording.time.values, case.recording.gyroscope.values, None
    times, *rest = case.recording
    return (times, *rest) if len(rest) == 2 else (times, np.zeros((len(times), 3)), *rest)


def truth(case: Case) -> tuple[Any, Any]:
    """Return the principal moments and the bounds of their standard errors."""
    time, rates, readings = samples(case)
    speed, values = None, np.zeros(0)
    attitudes = None
    if isinstance(readings, Rotation):
        attitudes = continuous(np.concatenate([[case.start[3:]], readings.as_quat()]))[1:]
    elif readings is not None:
        speed = as_speed(time, readings)
        values = np.interp(speed.knots, *case.speed)
    stretch = Stretch(time, rates, speed, attitudes, attitudes is None or len(case.recording) == 3)
    gyroscope, lanes, unit = plain_gyroscope(BIAS, SCALE), whole([stretch]), case.model.unit
    problem = Shooting([stretch], gyroscope, case.noise, case.model, "linear", lanes, case.tilt)
    errors = np.array([*case.bias, case.scale])
    at = Unknowns(case.inertia / unit, case.more, errors, case.start[None], values)
    covariance = np.linalg.pinv(Solution(problem, at, 0.0, residuals(problem, at)).information, hermitian=True)
    moments, axes = np.linalg.eigh(case.inertia)
    basis = case.model.basis.T
    by = np.array([[axes[:, k] @ symmetric(column) @ axes[:, k] for column in basis] for k in range(3)])
    return moments, unit * np.sqrt(np.einsum("km,mn,kn->k", by, covariance, by))


def study(kind: str, number: int) -> dict[str, Any]:
    """Fit one recording."""
    case = MODELS[kind](number)
    values, bounds = truth(case)
    made = with_moments([samples(case)[:2]], Model(), 2.0, 0.0) if kind == "throw" else None
    linear = np.full(3, np.nan) if made is None else np.linalg.eigvalsh(made.inertia)
    ratios = values[:2] / values[2]
    result = {"number": number, "rate": case.rate, "bound": (bounds / values).max(), "seconds": np.nan}
    result |= {"linear": (linear - values) / bounds, "failed": "", "error": np.full(3, np.nan)}
    result |= {"covered": np.zeros(5, dtype=bool), "untold": 5}
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = fit_inertia(case.recording, bias=BIAS, scale=SCALE, **case.how)
            found = fit.principal
    except ValueError as error:
        return result | {"failed": str(error)}
    intervals = np.concatenate([found.intervals, found.ratio_intervals])
    aims = np.concatenate([values, ratios])
    result["covered"] = (intervals[:, 0] <= aims) & (aims <= intervals[:, 1])
    return result | {
        "error": (found.moments - values) / bounds,
        "untold": len(fit.untold),
        "seconds": time.perf_counter() - begin,
    }


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--model", choices=list(MODELS), default="throw")
    asked = parser.parse_args()
    begin = time.perf_counter()
    with ProcessPoolExecutor(asked.workers) as pool:
        results = list(pool.map(partial(study, asked.model), range(asked.recordings), chunksize=5))
    print(f"{len(results)} recordings in {time.perf_counter() - begin:.0f} s with {asked.workers} workers")
    for failed in [one for one in results if one["failed"]]:
        print(f"  refused: recording {failed['number']}, bound {failed['bound']:.2%}: {failed['failed']}")
    fitted = [one for one in results if not one["failed"]]
    print(
        f"median {np.median([one['seconds'] for one in fitted]):.2f} s, "
        f"at most {max(one['seconds'] for one in fitted):.2f} s a fit"
    )
    for rate in (100, 400):
        own = [one for one in fitted if one["rate"] == rate]
        telling = [one for one in own if one["bound"] < BOUND]
        rest = [one for one in own if one["bound"] >= BOUND]
        covered = np.array([one["covered"] for one in telling])
        error, linear = (np.array([one[key] for one in telling]) for key in ("error", "linear"))
        print(f"{rate} Hz: {len(telling)} recordings with a bound below {BOUND:.0%}, {len(rest)} above")
        print(
            "  95 % intervals cover",
            ", ".join(f"{x:.1%}" for x in covered.mean(axis=0)),
            f"(J1 J2 J3 J1/J3 J2/J3), all {covered.mean():.1%}",
        )
        print(
            "  error / bound, r.m.s.:",
            ", ".join(f"{x:.3f}" for x in np.sqrt((error**2).mean(axis=0))),
            f"all {np.sqrt((error**2).mean()):.3f}",
        )
        if asked.model == "throw":
            print(
                "  the same of the linear method, median of |error| / bound:",
                ", ".join(f"{x:.3g}" for x in np.nanmedian(abs(linear), axis=0)),
            )
        print(
            "  of the others", sum(one["untold"] > 0 for one in rest), "are reported as undetermined in some direction"
        )


if __name__ == "__main__":
    main()
