"""How good are the intervals of `fit_inertia`? Throws of known bodies, recorded by a simulated gyroscope, and fitted.

    python examples/fit_study.py --recordings 1000

Each throw lasts 0.6 s. The gyroscope has white noise of 1.2e-4 rad/s/√Hz (0.007 °/s/√Hz), a bias of 0.02 rad/s along
each axis and a scale that is off by 1 %, both drawn from normal distributions, which are the priors of the fit; half of
the recordings are at 100 Hz and half at 400 Hz. Every other body is a phone, 147 × 72 × 8 mm, mounted with an error of
3°; the others are boxes with random sides, in random axes. The directions of the angular velocities are uniform on the
sphere, their sizes are 6 to 20 rad/s.

The bound of Cramér and Rao is that of the model at the truth, with the priors. A throw counts as telling where the
bound of all three moments is below 3 %.
"""

from __future__ import annotations

import argparse
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nontwist import fit_inertia, inertia_of_cuboid, sensors, simulate, standard
from nontwist.fitting.bodies import TRACELESS, symmetric
from nontwist.fitting.estimating import Priors, Problem, Solution, Stretch, Unknowns, residuals, whole
from nontwist.fitting.linear import weak_form

SECONDS, DENSITY, BIAS, SCALE, BOUND = 0.6, 1.2e-4, 0.02, 0.01, 0.03


def throw(number: int) -> tuple[Any, Any, Any, Any]:
    """Return J of trace 1, the recording, and the bias and the scale of the gyroscope."""
    rng = np.random.default_rng([2026, number])
    is_phone, rate = number % 2 == 0, (100, 400)[number // 2 % 2]
    sides = (0.147, 0.072, 0.008) if is_phone else rng.uniform(0.05, 0.2, 3)
    turned = Rotation.from_rotvec(rng.normal(size=3) * np.radians(3)) if is_phone else Rotation.random(rng=rng)
    J = turned.as_matrix() @ inertia_of_cuboid(1.0, sides) @ turned.as_matrix().T
    J = (J + J.T) / 2 / np.trace(J)
    direction = rng.normal(size=3)
    W = rng.uniform(6, 20) * direction / np.linalg.norm(direction)
    run = simulate(standard(J), t_end=SECONDS, step=1 / 400, material_angular_velocity=W)
    bias, scale = BIAS * rng.normal(size=3), 1 + SCALE * rng.normal()
    how = {"noise": DENSITY, "bias": bias, "scale": scale, "rate": rate, "seed": number}
    return J, sensors.gyroscope(run, **how), bias, scale


def truth(J: Any, recording: Any, bias: Any, scale: float) -> tuple[Any, Any]:
    """Return the principal moments and the bounds of their standard errors."""
    stretch = Stretch(recording.time.values, recording.gyroscope.values)
    noise = recording.attrs["noise"] * np.sqrt(recording.attrs["rate"] / 2)
    problem = Problem([stretch], Priors(BIAS, SCALE), noise, "linear", whole([stretch]))
    start = (recording.gyroscope.values[0] - bias) / scale  # within the noise of a sample, which is as good
    at = Unknowns(J, bias, scale, start[None])
    r, A = residuals(problem, at)
    covariance = np.linalg.pinv(Solution(problem, at, 0.0, r, A).information, hermitian=True)
    values, axes = np.linalg.eigh(J)
    by = np.array([[axes[:, k] @ symmetric(column) @ axes[:, k] for column in TRACELESS.T] for k in range(3)])
    return values, np.sqrt(np.einsum("km,mn,kn->k", by, covariance, by))


def study(number: int) -> dict[str, Any]:
    """Fit one throw."""
    J, recording, bias, scale = throw(number)
    values, bounds = truth(J, recording, bias, scale)
    pair = recording.time.values, recording.gyroscope.values
    made = weak_form([pair])
    linear = np.full(3, np.nan) if made is None else np.linalg.eigvalsh(made[0])
    ratios = values[:2] / values[2]
    result = {"number": number, "rate": recording.attrs["rate"], "bound": (bounds / values).max(), "seconds": np.nan}
    result |= {"linear": (linear - values) / bounds, "failed": "", "error": np.full(3, np.nan)}
    result |= {"covered": np.zeros(5, dtype=bool), "untold": 5}
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = fit_inertia(recording, interval="all", bias=BIAS, scale=SCALE)
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
    asked = parser.parse_args()
    begin = time.perf_counter()
    with ProcessPoolExecutor(asked.workers) as pool:
        results = list(pool.map(study, range(asked.recordings), chunksize=5))
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
        print(
            "  the same of the linear method, median of |error| / bound:",
            ", ".join(f"{x:.3g}" for x in np.nanmedian(abs(linear), axis=0)),
        )
        print("  of the others", sum(one["untold"] > 0 for one in rest), "are named as not told in some direction")


if __name__ == "__main__":
    main()
