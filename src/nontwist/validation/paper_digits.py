"""The numerical part of the paper: its six tables, its multiplier, and the closed form of its free discrete motion.

The loads of cases 2 and 3 are the printed ones divided by 20 (docs/errata.md, 1). Printed invariants are truncated to
six decimals, so they may differ by up to 1e-6. The second quotients contain the error of the paper's Newton iteration,
which was stopped at 1e-10.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import exact
from ..analysis.statistics import second_quotient
from ..driver.runs import integrate, simulate
from ..models.bodies import D3
from ..models.equations import constraint_matrices
from ..paper.tables import CASES, MISPRINT, QUOTIENT_TOLERANCE, STEP, T_END, invariants_table, quotient_table
from .checks import Check
from .compiled_steps import MidpointLoad, director_step
from .problems import FINE, PAPER_J, SAMPLES, Arguments, all_are, attitude, error

BODY = SAMPLES["nontwisting"]
SCHEME: Arguments = {"integrator": "energy-momentum", "order": 2}
TABLES = {
    1: ("tab-invariants_ic", "tab-sqp_ic"),
    2: ("tab-invariants_ml", "tab-sqp_ml"),
    3: ("tab-invariants_c", "tab-sqp_c"),
}
W1 = np.array(CASES[1].angular_velocity)


def tables() -> Iterator[Check]:
    """Compare the sixty printed numbers."""
    for number, case in CASES.items():
        kick: Arguments = {"t_end": T_END, "material_angular_velocity": case.angular_velocity, "load": case.load()}
        runs = [simulate(BODY, step=STEP / k, **kick, **SCHEME) for k in (1, 2, 4)]
        invariants, quotient = invariants_table(number, runs[0]), quotient_table(number, second_quotient(*runs))
        for name, table, source, tolerance, how in (
            ("invariants", invariants, TABLES[number][0], 1e-6, "digit by digit"),
            ("Q_II", quotient, TABLES[number][1], QUOTIENT_TOLERANCE, f"within {QUOTIENT_TOLERANCE:g}"),
        ):
            agreeing = sum(r.agrees for r in table.rows)
            yield Check(f"case {number}: {name} that agree {how}", len(table.rows), agreeing, 0, source, "printed")
            differences = [r.difference for r in table.rows]
            yield error(f"case {number}: {name}, worst difference", differences, tolerance, source, "printed")


def multiplier() -> Iterator[Check]:
    """Compare μ of case 1 with Π·(W × E3) = 468/7 at every step."""
    run = integrate(BODY, t_end=T_END, step=STEP, material_angular_velocity=W1, **SCHEME)
    source = "eq-nonholonomic (docs/errata.md, 3)"
    yield all_are("case 1: μ, N m", 468 / 7, run.multipliers[:, -1], 1e-9, source, "closed form")


def closed_form() -> Iterator[Check]:
    """Compare free runs with rotations by θ_h = 2 atan(|w| h/2) a step about a fixed axis, and their Q_II."""
    h, source = STEP, "eq-discrete-nonholonomic (docs/errata.md, 6)"
    run = integrate(BODY, t_end=1, step=h, material_angular_velocity=W1, **SCHEME)
    turn, angle = attitude(run)[1], 2 * np.arctan(float(np.linalg.norm(W1)) * h / 2)
    gap = float(np.arcsin(np.linalg.norm(turn - turn.T) / np.sqrt(8))) - angle
    yield error("case 1: angle of a step less θ_h, rad", gap, 1e-15, source, "closed form")
    states = exact.discrete_free(PAPER_J, W1, h, 200)[0]
    yield error("case 1: attitudes, turned by n θ_h", attitude(run) - states, 1e-11, source, "closed form")
    runs = [simulate(BODY, t_end=1, step=h / k, material_angular_velocity=W1, **SCHEME) for k in (1, 2, 4)]
    closed = exact.discrete_second_quotient(W1, h, runs[0].time.values[20:])
    relative = second_quotient(*runs).values[19:] / closed - 1
    yield error("case 1: Q_II from 0.1 s to 1 s, relative", relative, 1e-8, "eq:second_quotient", "closed form")


def remainder() -> Iterator[Check]:
    """Check that Q_II tends to 4 with the square of the step, in case 3."""

    def gap(h: float) -> float:
        kick: Arguments = {"t_end": 1, "material_angular_velocity": CASES[3].angular_velocity, "load": CASES[3].load()}
        return 4 - float(second_quotient(*(simulate(BODY, step=h / k, **kick, **SCHEME) for k in (1, 2, 4)))[-1])

    name = "case 3: 4 - Q_II, ratio of h = 0.02 s to 0.01 s"
    yield Check(name, 4, gap(0.02) / gap(0.01), 0.1, "eq:second_quotient (docs/errata.md, 8)", "order")


def impulse() -> Iterator[Check]:
    """Compare Π1 of the continuous equations after the load of case 2 with half its peak."""
    run = simulate(BODY, times=[0, 1], load=CASES[2].load(), integrator=FINE)
    expected, measured = CASES[2].printed_peak[0] / (2 * MISPRINT), float(run.material_momentum[-1, 0])
    name = "case 2: Π1 at 1 s, kg m² s⁻¹, printed peak over 40"
    yield Check(name, expected, measured, 1e-8, "eq-loads_time_variation (docs/errata.md, 1)", "closed form")


def parameter() -> Iterator[Check]:
    """Check that the parameter a moves λ12 alone, by -(½ - a) μ."""
    q, load = np.eye(3), MidpointLoad(np.array([1.0, 2.0, 0.0]), np.array([0.5, 0.0, 1.0]))
    v, no_force = np.cross(np.array([2.0, -3.0, 0.0]), q), np.zeros((3, 3))
    half, zero = (
        director_step(0, q, v, 0.01, BODY.euler_inertia, constraint_matrices(D3, a), no_force, load) for a in (0.5, 0)
    )
    source = "eq_weak_form_rigid_body_alternative (docs/errata.md, 5)"
    moved = [zero.directors - half.directors, zero.velocities - half.velocities]
    yield error("a = 0 for ½: change of the state", moved, 1e-12, source, "closed form")
    shifted = half.multipliers - np.array([0, 0, 0, 0, 0, half.multipliers[6] / 2, 0])
    gap = zero.multipliers - shifted
    yield error("a = 0 for ½: multipliers, λ12 less μ/2, N m", gap, 1e-11, source, "closed form")


CHECKS = (tables, multiplier, closed_form, remainder, impulse, parameter)
