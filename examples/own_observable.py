"""An observable of your own: the nutation angle, between the axis d₃ of a body and the vertical.

    θ = atan2(√(d₃ₓ² + d₃ᵧ²), d₃_z),        0 ≤ θ ≤ π,

which is exact near 0 and π, where arccos d₃_z has lost half the digits. In steady precession θ is constant; a heavy top
that is released at rest on its axis, spinning at W₃ about it, nutates between θ₀ and the θ₁ at which

    (1 - cos² θ₁) = 2 λ (cos θ₀ - cos θ₁),        λ = J₃² W₃² / (4 J₁ m g l),

by conservation of energy, π_z and Π₃ (H. Goldstein, Classical Mechanics, on the "fast top").
"""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nontwist import heavy_top, simulate, simulate_ensemble
from nontwist.analysis import OBSERVABLES, Observable
from nontwist.geometry.arrays import Array


def nutation(state: Any) -> Array:
    """Return θ, rad."""
    d = state.directors
    angle: Array = np.arctan2(np.hypot(d[..., 2, 0], d[..., 2, 1]), d[..., 2, 2])
    return angle


OBSERVABLES["nutation"] = Observable(nutation, "rad", "nutation angle, of d3 against the vertical", "θ")


def main() -> None:
    """Release a top, and compare its largest nutation angle with the closed form; the same of an ensemble."""
    J1, J3, W3, weight, tilt = 0.4, 0.2, 12.0, 1.5 * 9.81 * 0.3, 0.5
    top = heavy_top([J1, J1, J3], 1.5, [0, 0, 0.3])
    how: dict[str, Any] = {"t_end": 2, "rotation": Rotation.from_euler("x", tilt), "step": 1e-3}

    def lowest(t: float, state: Any) -> float:
        w = state.angular_velocity  # of d₃, whose height has the rate (w × d₃)_z
        x, y, _ = state.directors[2]
        return float(w[0] * y - w[1] * x)

    run = simulate(top, material_angular_velocity=(0, 0, W3), events=lowest, **how)
    ratio = (J3 * W3) ** 2 / (4 * J1 * weight)
    turn = np.arccos(ratio - np.sqrt(ratio**2 - 2 * ratio * np.cos(tilt) + 1))
    print(f"{run.nutation.attrs['long_name']}: {run.nutation.min():.6f} to {run.nutation.max():.6f} rad")
    print(f"closed form: {tilt:.6f} to {turn:.6f} rad")
    speeds = np.array([[0, 0, W3], [0, 0, 2 * W3]])
    many = simulate_ensemble(top, material_angular_velocity=speeds, variables=["nutation"], store=1, **how)
    print("largest by spin:", ", ".join(f"{x:.6f} rad" for x in many.nutation.max("time").values))


if __name__ == "__main__":
    main()
