"""A map of order and chaos: the largest Lyapunov exponent of a heavy top, over a plane of throws.

python examples/chaos_map.py 512 chaos.png    # a throw for each dot; some minutes
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from nontwist import heavy_top, lyapunov_ensemble

SPAN, STEP, FASTEST = 140.0, 0.04, 5.0  # s, s, rad/s


def exponents(points):
    """Return the velocities along an axis of the map, and the largest exponents, (points, points)."""
    top = heavy_top([1, 2, 2.5], mass=0.5, centre_of_mass=(0.3, 0, 0.4))
    speeds = np.linspace(-FASTEST, FASTEST, points)
    W1, W3 = np.meshgrid(speeds, speeds)
    throws = np.stack([W1, 0 * W1, W3], axis=-1).reshape(-1, 3)
    how = {"t_end": SPAN, "step": STEP, "integrator": "lie-midpoint"}
    found = lyapunov_ensemble(top, material_angular_velocity=throws, progress=points > 100, **how)
    return speeds, found.lyapunov_exponent.sel(exponent=1).values.reshape(points, points)


def draw(points, path):
    """Write the map as a picture."""
    speeds, largest = exponents(points)
    figure, ax = plt.subplots(figsize=(6.6, 5.4), dpi=120, layout="compressed")
    shades = ax.pcolormesh(speeds, speeds, largest, vmin=0, cmap="magma_r")
    ax.set(xlabel="$W_1$ / (rad/s)", ylabel="$W_3$ / (rad/s)", aspect="equal")
    figure.colorbar(shades, label="largest Lyapunov exponent / s$^{-1}$")
    figure.savefig(path)
    plt.close(figure)


if __name__ == "__main__":
    draw(int(sys.argv[1]), Path(sys.argv[2]))
