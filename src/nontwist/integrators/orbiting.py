"""The gravity gradient alone, linearised: a step of `gauss` as it looks from the orbit.

The rows of such a step turn with V = W - n o, n the mean motion, o = Σ o_k c_k the normal of the orbit as seen from the
body. With ``o' = o × W = o × V``, linear in the rows, V has stages as W has them, and a step solves

    V' = F(V, C) = S(τ - J a c') + a c' - n o × V,        c_k' = c_k × V,
    τ = J W × W + γ × ∂V/∂γ,    W = V + n o,    γ the radius of the beginning of the step as seen from the body,

a the constrained axis, c' the rate of its spin, S the inverse of J under the constraint (`gauss_linear`). These are the
equations of a body with the inertia I and no constraint, under a torque F that depends on the state, which the kernels
know. At fixed V and C, with ``W' = F + n o × V`` and the multiplier μ, F changes by

    moment dm:   S dm                         axis:  S(J a (da·W') - μ da) - a (da·W')
    inertia:     S(dJ W × W - dJ W')          spin:  (a - S J a) dc'
    dead force:  S(e_i × Λᵀ df^i)             n:     dn [S(J o × W + J W × o) - o × V],

and what J, n and the time do to the gradient is a moment. Back from (δ, V) to (δ, W): ``dV = dW - n o × δ - dn o`` at
both ends, and as the orbit turns by n h, the turn at the end changes by ``(h dn + n dh) o`` as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..engine.generalised import STAGE
from ..geometry.arrays import Array
from ..geometry.attitudes import States, attitudes, product
from ..geometry.tensors import BASIS, LEVI, hats
from ..loads.potentials import GravityGradient
from ..loads.state_derivatives import torque_slope
from .called_loads import Called, Evaluated, Stages
from .linear_inputs import Entries, Nodes


@dataclass(frozen=True)
class Orbit:
    """A body, and the orbit that it is seen from.

    Parameters
    ----------
    term : GravityGradient
    factor : float
        Of the load.
    J, S : (3, 3) array
    axis : (3,) array
        The constrained one, 0 where there is none.
    """

    term: GravityGradient
    factor: float
    J: Array
    S: Array
    axis: Array

    @property
    def rate(self) -> float:
        """The mean motion n."""
        return self.term.mean_motion

    def normals(self, states: States) -> Array:
        """Return the normal of the orbit as seen from the body, (n, 3)."""
        found: Array = self.term.normal @ attitudes(states.quaternion)
        return found

    def turned(self, times: Array) -> Array:
        """Return the turn of the orbit in some times, as quaternions (n, 4)."""
        half = self.rate * times / 2
        return np.column_stack([np.sin(half)[:, None] * self.term.normal, np.cos(half)])

    def seen(self, states: States, times: Array) -> States:
        """Return states at some times as seen from the orbit: quaternions since the first time, and V."""
        V = states.velocity - self.rate * self.normals(states)
        return States(product(self.turned(times[0] - times), states.quaternion), V)

    def complete(self, matrices: Array, states: States, sizes: Array, orbit: int, step: int) -> None:
        """Turn matrices of changes of (δ, V), (6, width, steps), into those of (δ, W), in place.

        `orbit` and `step` are the columns of dn and dh, negative where they are not wanted.
        """
        o = self.normals(states).T
        turn = self.rate * np.einsum("cij,ik->cjk", LEVI, o)  # n o × δ
        by_velocity = matrices[:, 3:6].copy()
        matrices[:, :3] -= np.einsum("rck,cjk->rjk", by_velocity, turn[:, :, :-1])
        if orbit >= 0:
            matrices[:, orbit] -= np.einsum("rck,ck->rk", by_velocity, o[:, :-1])
            matrices[:3, orbit] += sizes * o[:, 1:]
            matrices[3:6, orbit] += o[:, 1:]
        if step >= 0:
            matrices[:3, step] += self.rate * o[:, 1:]
        matrices[3:6] += np.einsum("cjk,jwk->cwk", turn[:, :, 1:], matrices[:3])


class Orbiting(Called):
    """What acts on some steps, seen from the orbit: F.

    Parameters
    ----------
    orbit : Orbit
    fractions : (s,) array
        Of a step, of the stages.
    rates : (steps,) array
        c' in the steps.
    """

    def __init__(self, orbit: Orbit, fractions: Array, rates: Array) -> None:
        super().__init__((orbit.term,), STAGE, False, False, orbit.factor)
        self.orbit, self._fractions = orbit, np.tile(fractions, len(rates))
        self._rates = np.repeat(rates, len(fractions))[:, None]
        self._lift = orbit.axis - orbit.S @ orbit.J @ orbit.axis

    def linear(self, stages: Stages) -> Evaluated:
        """Return F at some stages, and its derivatives."""
        orbit, at, (o, W) = self.orbit, self._at(stages), self._velocities(stages)
        J, S, n, f = orbit.J, orbit.S, orbit.rate, orbit.factor * orbit.term.scale
        torque, by = torque_slope(orbit.term, at)
        gyration = S @ (hats(W @ J) - hats(W) @ J)
        rows = np.einsum("cd,ndki->ncki", f * S, np.einsum("ncix,nxk->ncki", by, stages.R))
        rows += np.einsum("nci,nk->ncki", n * (gyration + hats(stages.W)), orbit.term.normal @ stages.R)
        attitude = np.einsum("ncki,kbl,nli->ncb", rows, LEVI, stages.C)
        F = (np.cross(W @ J, W) + f * torque) @ S + self._rates * self._lift - n * np.cross(o, stages.W)
        return Evaluated(self, stages, at, F, rows, gyration - n * hats(o), attitude, np.zeros_like(F))

    def moved(self, known: Evaluated, stages: Stages) -> Evaluated:
        """Return F at other stages, with its derivatives."""
        return self.linear(stages)

    def entries(self, given: Iterable[Entries], nodes: Nodes) -> Iterator[Entries]:
        """Yield what parameters do to F, to the step and to n, from what they do to the inputs of steps."""
        known, by = nodes.called, dict[str, Array]()
        assert known is not None
        s = len(nodes.middles)
        for entry in given:
            name = entry.name
            if name in ("step", "orbit"):
                yield entry
            if name not in by:
                by[name] = self._responses(name, known)
            component = entry.component
            if entry.step is None:
                node = np.broadcast_to(np.arange(len(by[name])), (len(component), len(by[name])))
            elif name == "moving":
                node, component = s * (entry.step - nodes.first)[:, None] + component[:, None] // 3, component % 3
            else:
                node = s * (entry.step - nodes.first)[:, None] + np.arange(s)
            value = entry.value[:, None, None] * by[name][node, :, component[:, None]]
            place = 3 * (node % s)[:, :, None] + np.arange(3)
            parameter, step = (
                np.broadcast_to(x[:, :, None], value.shape).ravel()
                for x in (entry.parameter[:, None] + 0 * node, nodes.first + node // s)
            )
            yield Entries("moving", place.ravel(), parameter, value.ravel(), step)

    def _velocities(self, stages: Stages) -> tuple[Array, Array]:
        """Return o and W at some stages."""
        o = np.einsum("nki,nk->ni", stages.C, self.orbit.term.normal @ stages.R)
        return o, stages.W + self.orbit.rate * o

    def _responses(self, name: str, known: Evaluated) -> Array:
        """Return by how much F changes with the components of an input, (n, 3, components)."""
        orbit, stages, (o, W) = self.orbit, known.stages, self._velocities(known.stages)
        J, S, V = orbit.J, orbit.S, stages.W
        K, h = known.torque + orbit.rate * np.cross(o, V), stages.sizes[:, None]
        if name == "moving":
            return np.broadcast_to(S, (len(W), 3, 3))
        if name == "inertia":
            by = [(np.cross(W @ dJ, W) - K @ dJ) @ S for dJ in BASIS]
        elif name == "axis":
            torque = np.cross(W @ J, W) + orbit.factor * orbit.term.scale * known.of(orbit.term)
            mu = (torque - K @ J) @ orbit.axis
            by = [-np.outer(K[:, c], self._lift) - np.outer(mu, S[c]) for c in range(3)]
        elif name == "dead":
            attitude = attitudes(orbit.turned(self._fractions * stages.sizes)) @ stages.R @ stages.C
            by = [np.cross(e, attitude[:, x]) @ S for e in np.eye(3) for x in range(3)]
        elif name == "orbit":
            by = [(np.cross(o @ J, W) + np.cross(W @ J, o)) @ S - np.cross(o, V)]
        else:
            by = [self._lift / h] if name == "spin" else [-self._rates * self._lift / h]
        return np.stack(by, axis=2)
