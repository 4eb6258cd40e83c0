"""A load of your own: the moment of a uniform magnetic field on a magnet that is fixed in the body.

The dipole has the components D along the directors, D = Σ D_i d_i in space, so that

    m = D × B,        V = -D·B.

V is linear in the directors, so the dead forces D_i B of a body give the same motion. They are computed by
different code, which checks this load.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from nontwist import DirectorSystem, sensitivities, simulate, standard
from nontwist.geometry.arrays import Array
from nontwist.loads import LOADS, Term
from nontwist.spec import Spec


@dataclass(frozen=True, eq=False)
class Magnet(Term):
    """A magnet in a uniform field."""

    dipole: Annotated[Array, Spec("along the directors", unit="A m²", shape=(3,))]
    field: Annotated[Array, Spec("along fixed axes", unit="T", shape=(3,))]

    def moment(self, t: float, directors: Array, angular_velocity: Array) -> Array:
        """Return D × B in space."""
        return np.cross(self.dipole @ directors, self.field)

    @classmethod
    def sample(cls) -> "Magnet":
        """Return the magnet that `nontwist validate` checks."""
        return cls(np.array([0.3, 0.0, 1.2]), np.array([0.0, 1.0, -2.0]))


LOADS["magnet"] = Magnet


def main() -> None:
    """Let a magnet go in the field: energies, the same motion by dead forces, and how it depends on the dipole."""
    body, dipole, field = standard([2e-5, 3e-5, 4e-5]), np.array([0.3, 0.0, 1.2]), np.array([2e-5, 0.0, -4e-5])
    load = Magnet(dipole, field)
    twin = DirectorSystem(body.euler_inertia, dead_force=np.outer(dipole, field))
    how: dict[str, Any] = {"t_end": 20, "step": 0.02, "material_angular_velocity": (0.5, 0, 2)}
    for integrator in ("lie-midpoint", "energy-momentum", "split"):
        run = simulate(body, load=load, integrator=integrator, **how)
        other = simulate(twin, integrator=integrator, **how)
        K, V = run.kinetic_energy.values, -np.einsum("i,tix,x->t", dipole, run.directors.values, field)
        work = K - K[0] - np.append(0, np.cumsum(run.load_work))
        print(
            f"{integrator:15} K - work to {abs(work).max() / K.max():.0e}, "
            f"K + V to {np.ptp(K + V) / K.max():.0e}; "
            f"from the motion by dead forces {abs(run.directors - other.directors).max().item():.0e}"
        )
    d = sensitivities(body, load=load, wrt="dipole", store="end", **how)
    turn = np.linalg.norm(d.d_rotation.values[-1], axis=0)
    print("1 mA m² more of it turns the end by", ", ".join(f"{1e-3 * x:.3f} rad" for x in turn))


if __name__ == "__main__":
    main()
