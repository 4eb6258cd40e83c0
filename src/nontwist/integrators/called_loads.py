"""What depends on the state, linearised at the stages of some steps: moments of functions, director forces, potentials.

A step of collocation has at a stage the rows c_k of C, the attitude Λ = R C, R that of its beginning, and the velocity
W. Terms are functions of the directors, the columns of Λ, of w = ΛW, and of the half turn b = hW/2 of a midpoint step.
With f = Rᵀm, F = ∂f/∂C, G = ∂f/∂ω for ω = C W, B = ∂f/∂b, and a turn δ of the body at the beginning,

    df = F:dC + G (dC W + C dW) + B (h dW + W dh)/2 - δ × f + F:(δ̂C) + G (δ × ω),
    τ = C⁻¹ f,        dτ = C⁻¹ (df - dC τ),

the torque that the step has in its equations; `gauss` takes the torque of potentials itself. A midpoint step of
`energy_momentum` has C = M(a), a = hΩ/2, dM = M dâ M, and w = R sΩ, s = 1/(1 + |a|²), one of `lie_midpoint` with
dissipation w = RΩ; they want f, and with the moments
of the paper y = (2f + (a·f) a)/(1 + s) of director forces and potentials (`engine.generalised`).

The kernels take the torque as linear about known stages (`engine.linearised.Step`). Of midpoint steps these are known
from the states at both ends. Others are solved with what is linear, which gives the next ones: the iteration of Newton
with derivatives that are frozen, to the round-off of the stages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..engine.generalised import PAPER, STAGE
from ..geometry.arrays import Array
from ..geometry.attitudes import attitudes, product
from ..geometry.tensors import LEVI, hats
from ..loads.forces import DirectorForces
from ..loads.potentials import Potential
from ..loads.state_derivatives import At, Slope, moment_slope, moments, parts_of_time, time_rates, torque_slope
from ..loads.terms import Damping, Rotor, Term

I3 = np.eye(3)
MOST, STILL, SMALL = 40, 8e-16, 1e-12  # iterations; turns and changes of rows that are round-off, that may be


def is_called(term: Term) -> bool:
    """Whether a term depends on the state, and is nothing that kernels know: damping, a rotor, a dead force."""
    if term.kind in ("body", "space") or isinstance(term, Damping | Rotor):
        return False
    return not isinstance(term, Potential) or term.dead_force is None


class Stages(NamedTuple):
    """Where what depends on the state is evaluated, one row a node."""

    times: Array  # (n,)
    sizes: Array  # (n,) of the steps
    R: Array  # (n, 3, 3)
    C: Array  # (n, 3, 3), rows c_k; of a director scheme M
    W: Array  # (n, 3); of a director scheme Ω

    @property
    def shrinking(self) -> Array:
        """s, (n, 1), of a director scheme."""
        a = self.turn
        found: Array = 1 / (1 + (a * a).sum(axis=1, keepdims=True))
        return found

    @property
    def turn(self) -> Array:
        """Half the turn of the step, a = hW/2, (n, 3)."""
        return self.sizes[:, None] * self.W / 2


def states_at_middles(p: Array, h: Array, times: Array) -> Stages:
    """Return the middles of midpoint steps, which turn by ``cay(hΩ)``, from the quaternions at all nodes."""
    R = attitudes(p)
    turn = product(p[:-1] * [-1, -1, -1, 1], p[1:])
    Om = 2 / h[:, None] * turn[:, :3] / turn[:, 3:]
    a = h[:, None] * Om / 2
    M = (I3 + hats(a) + a[:, :, None] * a[:, None]) / (1 + (a * a).sum(axis=1))[:, None, None]
    return Stages(times, h, R[:-1], M, Om)


def guessed(p: Array, W: Array, h: Array, times: Array, a: Array) -> Stages:
    """Return stages of collocation with velocities on the chord of those of the nodes, a the matrix of the method.

    Their rows follow from these: ``c_k,i = e_k + h Σ a_ij c_k,j × W_j``.
    """
    n, s = len(h), len(a)
    along = a.sum(axis=1)[:, None]
    stages = W[:-1, None] + along * (W[1:] - W[:-1])[:, None]
    T = np.einsum("n,ij,njrc->nirjc", h, a, hats(stages.reshape(-1, 3)).reshape(n, s, 3, 3))
    T = T.reshape(n, 3 * s, 3 * s) + np.eye(3 * s)
    C = np.linalg.solve(T, np.tile(I3, (n, s, 1))).reshape(n, s, 3, 3).swapaxes(2, 3)
    R = np.repeat(attitudes(p[:-1]), s, axis=0)
    return Stages(times, np.repeat(h, s), R, C.reshape(-1, 3, 3), stages.reshape(-1, 3))


def settled(called: Called, stages: Stages, solve: Callable[[Evaluated], Array]) -> Evaluated:
    """Return what acts at the stages, once these are the solution of the steps under it.

    `solve` returns velocities and rows, (n, 12), under what is linear.
    """
    known, before = called.linear(stages), np.inf
    for _ in range(MOST):
        found = solve(known)
        W, C = found[:, :3], found[:, 3:].reshape(-1, 3, 3)
        moved = abs(stages.sizes[:, None] * (W - stages.W)).max() + abs(C - stages.C).max()
        stages = stages._replace(W=W, C=C)
        if not np.isfinite(moved) or moved <= STILL or (moved <= SMALL and moved >= before):
            break
        known, before = called.moved(known, stages), moved
    return called.linear(stages)


class Called:
    """The terms of a load that depend on the state, for one scheme.

    Parameters
    ----------
    terms : tuple of Term
    action : int
        What the scheme makes of director forces and potentials.
    in_space : bool
        Whether it takes moments as functions of one velocity Ω of the step, as seen at its beginning.
    shrinks : bool
        Whether functions get ``w = sΩ`` then, and not Ω.
    factor : float
        Of the load.
    """

    def __init__(self, terms: tuple[Term, ...], action: int, in_space: bool, shrinks: bool, factor: float) -> None:
        self.terms, self._action, self._in_space, self._factor = terms, action, in_space, factor
        self._shrinks = shrinks

    def linear(self, stages: Stages) -> Evaluated:
        """Return what acts at some stages, and its derivatives."""
        at, n = self._at(stages), len(stages.times)
        torque, rows, velocity, attitude = (np.zeros((n, *shape)) for shape in ((3,), (3, 3, 3), (3, 3), (3, 3)))
        by_step = np.zeros((n, 3))
        for term in self.terms:
            of = self._torque if self._is_torque(term) else self._paired if self._in_space else self._drawn
            parts = of(term, at, stages)
            for total, part in zip((torque, rows, velocity, attitude, by_step), parts, strict=True):
                total += self._factor * term.scale * part
        return Evaluated(self, stages, at, torque, rows, velocity, attitude, by_step)

    def moved(self, known: Evaluated, stages: Stages) -> Evaluated:
        """Return what acts at other stages, with the derivatives as they are."""
        at = self._at(stages)
        torque = sum(self._factor * term.scale * self.torques(term, at, stages) for term in self.terms)
        return known._replace(stages=stages, at=at, torque=np.asarray(torque))

    def change(self, term: Term, moment: Array, stages: Stages) -> Array:
        """Return what a moment of a term in space does: a torque, or a moment in space in a director scheme."""
        f = np.einsum("nxc,nx->nc", stages.R, moment)
        if not self._in_space:
            found: Array = np.linalg.solve(stages.C, f[:, :, None])[:, :, 0]
        else:
            found = np.einsum("ncx,nx->nc", stages.R, self._pair(term, f, stages))
        return found

    def torques(self, term: Term, at: At, stages: Stages) -> Array:
        """Return what a term does without its factor, as `change` returns it."""
        if self._is_torque(term):
            return torque_slope(term, at)[0]  # type: ignore[arg-type]
        return self.change(term, moments(term, at), stages)

    def _at(self, stages: Stages) -> At:
        Λ = stages.R @ stages.C
        if self._shrinks:
            w = np.einsum("ncx,nx->nc", stages.R, stages.shrinking * stages.W)
        else:
            w = np.einsum("ncx,nx->nc", Λ, stages.W)
        half = np.zeros_like(stages.W) if self._action == STAGE else stages.turn
        scale = float(abs(w).max()) or 1 / float(abs(stages.sizes).min())
        return At(stages.times, np.ascontiguousarray(Λ.swapaxes(1, 2)), w, half, scale)

    def _is_torque(self, term: Term) -> bool:
        return self._action == STAGE and isinstance(term, Potential)

    def _torque(self, term: Term, at: At, stages: Stages) -> tuple[Array, ...]:
        """Return the torque of a potential at a stage, and what it changes by."""
        torque, by = torque_slope(term, at)  # type: ignore[arg-type]
        rows = np.einsum("ncix,nxk->ncki", by, stages.R)
        attitude = np.einsum("ncki,kbl,nli->ncb", rows, LEVI, stages.C)
        return torque, rows, np.zeros((len(torque), 3, 3)), attitude, np.zeros_like(torque)

    def _drawn(self, term: Term, at: At, stages: Stages) -> tuple[Array, ...]:
        """Return the torque of a moment in space, and what it changes by."""
        (R, C, W), h = stages[2:], stages.sizes[:, None]
        f, F, G, B = _seen(moment_slope(term, at), R)
        inverse = np.linalg.inv(C)
        F = F + np.einsum("nck,ni->ncki", G, W)
        attitude = np.einsum("ncki,kbl,nli->ncb", F, LEVI, C) + np.einsum("cib,ni->ncb", LEVI, f)
        velocity = G @ C + h[:, :, None] / 2 * B
        torque = np.einsum("ncd,nd->nc", inverse, f)
        rows = np.einsum("ncd,ndki->ncki", inverse, F) - np.einsum("nck,ni->ncki", inverse, torque)
        by_step = np.einsum("ncd,ndx,nx->nc", inverse, B, W / 2)
        return torque, rows, inverse @ velocity, inverse @ attitude, by_step

    def _paired(self, term: Term, at: At, stages: Stages) -> tuple[Array, ...]:
        """Return the moment as seen at the beginning of the step, and what it changes by."""
        (R, M, Om), a, h = stages[2:], stages.turn, stages.sizes[:, None]
        s = stages.shrinking
        slower, by_slower = (s, -2 * s * s * a) if self._shrinks else (np.ones_like(s), 0 * a)  # of w, and by a
        f, F, G, B = _seen(moment_slope(term, at), R)
        # by a: dM = M dâ M, and of w = sΩ through s alone
        by_turn = np.einsum("ncki,nkp,pbq,nqi->ncb", F, M, LEVI, M) + B
        by_turn += np.einsum("nck,nk,nb->ncb", G, Om, by_slower)
        attitude = np.einsum("ncki,kbl,nli->ncb", F, LEVI, M) + np.einsum("cib,ni->ncb", LEVI, f)
        attitude += np.einsum("nck,kbl,nl->ncb", G, LEVI, slower * Om)
        velocity = h[:, :, None] / 2 * by_turn + slower[:, :, None] * G
        if self._action == PAPER and isinstance(term, DirectorForces | Potential):
            y, along = self._pair(term, f, stages), (a * f).sum(axis=1)

            def paired(df: Array) -> Array:
                df = 2 * df + np.einsum("nc,nd,ndb->ncb", a, a, df)
                return np.asarray(df / (1 + s[:, :, None]))

            ds = -2 * s * s * a
            own = np.einsum("nc,nb->ncb", a, f) + along[:, None, None] * I3 - np.einsum("nc,nb->ncb", y, ds)
            own = own / (1 + s[:, :, None])
            by_turn = paired(by_turn) + own
            velocity, attitude = paired(velocity) + h[:, :, None] / 2 * own, paired(attitude)
            f = y
        by_step = np.einsum("ncb,nb->nc", by_turn, Om / 2)
        none = np.zeros((len(f), 3, 3, 3))
        return f, none, velocity, attitude, np.einsum("ncx,nx->nc", R, by_step)

    def _pair(self, term: Term, f: Array, stages: Stages) -> Array:
        """Return y of director forces and potentials where a scheme takes it, f of other terms."""
        if not (self._action == PAPER and isinstance(term, DirectorForces | Potential)):
            return f
        a = stages.turn
        y: Array = (2 * f + (a * f).sum(axis=1, keepdims=True) * a) / (1 + stages.shrinking)
        return y


class Evaluated(NamedTuple):
    """What acts at some stages: a torque, in a director scheme a moment as seen at the beginning of the step."""

    called: Called
    stages: Stages
    at: At
    torque: Array  # (n, 3)
    rows: Array  # (n, 3, 3, 3) by the component i of the row k: [c, k, i]
    velocity: Array  # (n, 3, 3)
    attitude: Array  # (n, 3, 3)
    by_step: Array  # (n, 3) by the length of the step; in a director scheme in space

    def laid_out(self, B: Array) -> Array:
        """Return what the kernels read, (n, CALLED), in the frame of the columns of B."""
        n, s = len(self.torque), self.stages
        base = self.torque - np.einsum("ncb,nb->nc", self.velocity, s.W) - np.einsum("ncki,nki->nc", self.rows, s.C)
        columns = [np.einsum("xb,ncx,cy->nby", B, A, B).reshape(n, 9) for A in (self.velocity, self.attitude)]
        rows = np.einsum("ncki,cx,ky,iz->nyzx", self.rows, B, B, B, optimize=True)
        return np.concatenate([base @ B, *columns, rows.reshape(n, 27)], axis=1)

    def of(self, term: Term) -> Array:
        """Return what a term does, without its factor, as a parameter of the step acts."""
        return self.called.torques(term, self.at, self.stages)

    def of_moment(self, term: Term, moment: Array) -> Array:
        """Return what a moment of a term in space does, as a parameter of the step acts."""
        return self.called.change(term, moment, self.stages)

    def of_time(self, term: Term) -> Array:
        """Return what a term does for each second by which the nodes are later, without its factor."""
        if isinstance(term, Potential):
            return sum((c * self.of(part) for c, part in parts_of_time(term)), np.zeros_like(self.torque))
        return self.called.change(term, time_rates(term, self.at), self.stages)


def _seen(slope: Slope, R: Array) -> tuple[Array, Array, Array, Array]:
    """Return f, F, G, B of a moment."""
    f = np.einsum("nxc,nx->nc", R, slope.moment)
    F = np.einsum("ndc,ndix,nxk->ncki", R, slope.directors, R)
    return f, F, np.einsum("ndc,ndx,nxk->nck", R, slope.velocity, R), np.einsum("ndc,ndb->ncb", R, slope.half)
