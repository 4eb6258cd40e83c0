"""A body of one's own: a wheel that spins on the end of an axle, which is held at its other end.

With the axle level the wheel does not fall: it goes round the vertical at the steady rate

    Ω = m g l / (J3 W3),

whatever the spin W3. For d3 level and w = W3 d3 + Ω e_z the momentum is π = J3 W3 d3 + J1 Ω e_z, its rate
J3 W3 Ω e_z × d3, and the moment of the weight m g l e_z × d3: equal for this Ω, without approximation.
"""

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from nontwist import DirectorSystem, heavy_top, inertia, simulate
from nontwist.models.bodies import BODIES, BodyKind
from nontwist.spec import Spec


def wheel(
    mass: float,
    radius: Annotated[float, Spec("of the wheel, a cylinder about the third director", unit="m", rule="positive")],
    width: Annotated[float, Spec("of the wheel", unit="m", rule="positive")],
    arm: Annotated[float, Spec("from the fixed point to the centre of the wheel", unit="m")],
    gravity: ArrayLike = (0, 0, -9.81),
) -> DirectorSystem:
    """Return a solid wheel on a light axle, held in a point of the axle, under gravity.

    Parameters
    ----------
    mass : float, kg
    radius, width : float, m
        Of the wheel, a cylinder about the third director.
    arm : float, m
        From the fixed point to the centre of the wheel.
    gravity : (3,) array, m/s²
        In space.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        Mass, radius or width not positive; not finite.
    """
    centre = (0, 0, arm)
    J = inertia.shift(inertia.of_cylinder(mass, radius, width), mass, centre)
    return replace(heavy_top(J, mass, centre, gravity), name="wheel")


BODIES["wheel"] = BodyKind(wheel, "wheel on an axle", {"mass": 2.0, "radius": 1.2, "width": 0.2, "arm": 0.2})


def main() -> None:
    """Let the wheel go round with its axle level, and compare with Ω."""
    mass, radius, arm, spin = 2.0, 0.3, 0.2, 60.0  # kg, m, m, rad/s
    body = wheel(mass, radius, 0.02, arm)
    rate = mass * 9.81 * arm / (body.convected_inertia[2, 2] * spin)
    level = Rotation.from_rotvec([0, np.pi / 2, 0])  # takes e_z to e_x
    print(f"rate by the formula: {rate:.9f} rad/s")
    how: dict[str, Any] = {"t_end": 1, "step": 1e-3, "rotation": level, "angular_velocity": (spin, 0, rate)}
    for integrator in ("gauss", "energy-momentum", "split", "continuous"):
        run = simulate(body, integrator=integrator, **how)
        x, y, z = run.directors.sel(director=3).values.T
        measured = np.unwrap(np.arctan2(y, x))[-1]  # rad, in 1 s
        energy = (run.kinetic_energy + run.potential_energy).values
        drift = abs(energy - energy[0]).max() / run.kinetic_energy.values[0]
        print(
            f"{integrator:15} {measured:.9f} rad/s, relative error {abs(measured / rate - 1):.0e}; "
            f"level to {abs(z).max():.0e}; K + V to {drift:.0e}"
        )


if __name__ == "__main__":
    main()
