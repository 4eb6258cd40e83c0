"""The drift of the invariants over 10⁶ steps of 0.005 s.

Drifts are relative to the kinetic energy at the start and to the first momentum; that of the attitude is the largest
entry of ``q qᵀ - I``. The integrator `split` of orders 2 and 4 conserves the energy of a heavy top to its order only.
"""

from __future__ import annotations

import subprocess
import sys
from time import perf_counter

import numpy as np

from nontwist import integrate
from nontwist.integrators import INTEGRATORS
from nontwist.results import Trajectory

from .rows import Row
from .workloads import GRAVITY, Array, Workload, workload

STEPS, STEP, POINTS = 10**6, 0.005, 1000
PATIENCE = 60.0  # seconds that a run may take
MOTIONS = ("A", "C", "T")
RUNS = (("gauss", 4), ("lie-midpoint", 2), ("energy-momentum", 2), ("split", 2), ("split", 4))


def rows() -> list[Row]:
    """Measure all."""
    found = []
    for name, order in RUNS:
        for key in MOTIONS:
            found += drifts(name, order, workload(key))
    return [*found, memory()]


def drifts(name: str, order: int, w: Workload) -> list[Row]:
    """Return the drifts of a run of 10⁶ steps, and of 10⁷ where there is time."""
    label = f"{name} {order}, {w.key}"
    if name not in INTEGRATORS or order not in INTEGRATORS[name].orders:
        return [Row(f"{label}: 10⁶ steps", None, "", 1e-12, True, "not measured: not there yet")]
    try:
        once = trial(name, order, w)
    except ValueError as reason:
        return [Row(f"{label}: 10⁶ steps", None, "", 1e-12, True, f"not measured: {reason}")]
    if once * STEPS > PATIENCE:
        note = f"not measured: 10⁶ steps would take {once * STEPS:.0f} s"
        return [Row(f"{label}: 10⁶ steps", None, "", 1e-12, True, note)]
    found = []
    for what, drift in invariants(w, run(name, order, w, STEPS)).items():
        growth = f", grows like n^{exponent(drift):.2f}" if drift.max() > 0 else ""
        is_kept = not (name == "split" and what == "energy" and w.mass)  # gravity is a kick: it is bounded, not kept
        found.append(Row(f"{label}: {what}{growth}", float(drift.max()), "", 1e-12 if is_kept else None, True))
    if once * 10 * STEPS <= PATIENCE:
        worst = max(drift.max() for drift in invariants(w, run(name, order, w, 10 * STEPS)).values())
        found.append(Row("   after 10⁷ steps, the largest of them", float(worst), ""))
    return found


def run(name: str, order: int, w: Workload, steps: int) -> Trajectory:
    """Return a run that keeps about a thousand states."""
    return integrate(
        w.system,
        t_end=steps * STEP,
        step=STEP,
        material_angular_velocity=w.velocity,
        load=w.load,
        integrator=name,
        order=order,
        store=max(1, steps // POINTS),
    )


def trial(name: str, order: int, w: Workload) -> float:
    """Return seconds a step."""
    run(name, order, w, 20)
    start = perf_counter()
    run(name, order, w, 500)
    return (perf_counter() - start) / 500


def invariants(w: Workload, trajectory: Trajectory) -> dict[str, Array]:
    """Return the relative drift of all that the motion keeps, at the stored states."""
    q, v, E = trajectory.directors, trajectory.director_velocities, w.system.euler_inertia
    p = np.einsum("ij,njx->nix", E, v)
    momentum = np.cross(q, p).sum(1)
    kinetic = 0.5 * (v * p).sum((1, 2))
    potential = -(w.system.dead_force * q).sum((1, 2))
    energy = kinetic + potential
    found = {"energy": abs(energy - energy[0]) / kinetic[0]}
    if w.has_axis:
        material = np.einsum("nix,nx->ni", q, momentum)[:, :2]
        found["Π₁, Π₂"] = np.linalg.norm(material - material[0], axis=1) / np.linalg.norm(material[0])
    elif w.mass:
        vertical = momentum @ np.array(GRAVITY) / np.linalg.norm(GRAVITY)
        found["vertical momentum"] = abs(vertical - vertical[0]) / np.linalg.norm(momentum[0])
    else:
        found["momentum"] = np.linalg.norm(momentum - momentum[0], axis=1) / np.linalg.norm(momentum[0])
    found["orthonormality"] = abs(np.einsum("nix,njx->nij", q, q) - np.eye(3)).max((1, 2))
    return found


def exponent(drift: Array) -> float:
    """Return the slope of the largest drift so far over the number of steps."""
    largest = np.maximum.accumulate(drift)[1:]
    steps = np.arange(1, len(drift))
    use = largest > 0
    return float(np.polyfit(np.log(steps[use]), np.log(largest[use]), 1)[0])


CHILD = """
import pathlib, resource
from benchmarks.longruns import STEPS, run, trial
from benchmarks.workloads import workload
w = workload("C")
name = {name!r}
once = trial(name, 2, w)
run(name, 2, w, 2000)
def peak():
    status = pathlib.Path("/proc/self/status")
    if status.exists():
        return next(float(x.split()[1]) / 1024 for x in status.read_text().splitlines() if x.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
base = peak()
if once * STEPS > {patience}:
    print("slow", once * STEPS)
else:
    run(name, 2, w, STEPS)
    print("peak", peak() - base)
"""


def memory() -> Row:
    """Return the peak memory of 10⁶ steps with 1001 states kept, beyond the process that has imported and run."""
    name = "lie-midpoint"
    label = f"{name} 2, C: memory of 10⁶ steps, every 1000th kept"
    code = CHILD.format(name=name, patience=PATIENCE)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    if result.returncode:
        return Row(label, None, "MB", 50, True, f"not measured: {result.stderr.strip().splitlines()[-1]}")
    word, number = result.stdout.split()[-2:]
    if word == "slow":
        return Row(label, None, "MB", 50, True, f"not measured: 10⁶ steps would take {float(number):.0f} s")
    return Row(label, float(number), "MB", 50, True)
