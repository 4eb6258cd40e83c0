"""How the turn of a linearised step of `gauss` changes with its stages: θ = Σ Θ_i dV_i + ... (`gauss_derivatives`).

Of the rows: the scheme is symplectic, so it is its own adjoint, and with columns c_k of C_i and of C_{n+1}

    dc_k,n+1 = Σ h b_i C_{n+1} C_iᵀ (c_k,i × dV_i),     dc_k = c_k × θ,     θ = ½ Σ dc_k × c_k,
    Θ_i = h b_i C_{n+1} (c_2,i × c_3,i, c_3,i × c_1,i, c_1,i × c_2,i)ᵀ.

About a line: the text of `gauss` on duals, in the directions of Σ h b_i W_i, of ψ, and of the known vector at both
ends. It is divided by the turn of the step. Below some turn its round-off is larger than the difference from the turn
of the rows, which is of the order of the scheme, so that is taken. Of a velocity that stands still C = exp(hŴ) and ``θ
= ∫ exp((t - h) Ŵ) dW dt``, exact for a change of W that stands still as well. Forces under which a free body would
turn otherwise have no derivative of that run: theirs is that of the rows. In an orbit of the rate n about o the
attitude turns by n h as well, and W = V + n o.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..engine.records import Body
from ..engine.sampling import TINY
from ..kernels.control import Variables, loop, when
from ..kernels.dual import plain, seeded, tangent
from ..kernels.elements import any_of, select, sqrt
from ..kernels.memory import View, vector_at
from ..kernels.vectors import AXES, Matrix, Quaternion, Vector, attitude, cross
from .gauss import FAINT, about, arc, line, turned_about
from .gauss_coefficients import TABLE
from .gauss_newton import three_tangents

if TYPE_CHECKING:
    from .gauss_derivatives import Collocation, StageEquations

LEAST_TURN = {1: 2e-5, 2: 1e-3, 3: 1e-2}  # rad, of a step of so many stages that turns about a line; of more, 5e-2


class Turn:
    """How the turn of a step changes: that of the rows."""

    def __init__(self, steps: Collocation) -> None:
        self.steps = steps

    def set(self) -> None:
        """Set Θ, and, where it is not 0, what V at the end does to the turn."""
        self.by_step = self.set_by_rows()

    def set_by_rows(self, mask: Any = True) -> Vector:
        """Set Θ of the rows where a mask is set; return what the turn changes by with the length of the step."""
        steps, v = self.steps, Variables(total=0.0 * self.steps.V[0])
        for i, stage in steps.stages.each():
            C = steps.C[i, 0]
            A = Matrix(cross(C[1], C[2]), cross(C[2], C[0]), cross(C[0], C[1]))
            theta = (steps.h * steps.weight(i)) * (steps.turn.T @ A)
            v.total = v.total + theta @ stage.V
            steps.theta[i, 0] = theta if mask is True else select(mask, theta, steps.theta[i, 0])
        return (1.0 / steps.h) * v.total

    def begin(self, e: StageEquations, W: Vector, count: int) -> None:
        """Begin with the equations in the directions of columns, and W at the beginning."""
        self.equations, self.known, self.W, self.count = e, e.nodes, W, count

    def add_changes(self, i: Any, stage: View, g: Any) -> None:
        """Take up what does not change V at a stage."""

    def changes(self, V: Vector) -> list[Vector]:
        """Return what changes the turn in each direction beside V at the stages."""
        return [tangent(self.known.h, j) * self.by_step for j in range(self.count)]


class Steady(Turn):
    """That of a velocity that stands still."""

    def set(self) -> None:
        """Set Θ."""
        steps, v = self.steps, Variables(total=0.0 * self.steps.turn)
        for i, _ in steps.stages.each():
            cosm1, x = about(((steps.table[TABLE.nodes + i] - 1.0) * steps.h) * steps.V[0])
            theta = (steps.h * steps.weight(i)) * attitude(Quaternion(1.0 + cosm1, *x))
            v.total = v.total + theta
            steps.theta[i, 0] = theta
        self.total = v.total

    def changes(self, V: Vector) -> list[Vector]:
        """Return that of the exponential, less what the stages make of it."""
        cosm1, x = about(self.known.h * V)
        found = rotation_tangents(Quaternion(1.0 + cosm1, *x), self.count)
        return [theta - self.total @ tangent(V, j) for j, theta in enumerate(found)]


class Line(Turn):
    """That about a line: of the momentum of a free body, or of the vertical."""

    def set(self) -> None:
        """Set Θ, and what V at the end does to the turn."""
        steps, h, body = self.steps, self.steps.h, self.steps.body
        self.is_momentum = steps.motion == "free"
        self.f, g0, g1 = self.directions(body, *steps.W)
        if not self.is_momentum:
            g0 = steps.plain.start[0]
            g1 = g0 @ steps.turn
        v = Variables(w=0.0 * steps.V[0], psi=0.0 * h, by_line=0.0 * steps.V[0], by_step=0.0 * steps.V[0])
        for i, stage in steps.stages.each():
            v.w = v.w + (h * steps.weight(i)) * stage.V
        w = v.w
        self.r, lines = line(w, g0, g1), line(seeded(w), g0, g1)
        for i, stage in steps.stages.each():
            psi = arc((h * steps.weight(i)) * stage.V, self.direction(stage.V, steps.vectors(stage)), lines)
            v.psi, v.by_line = v.psi + plain(psi), v.by_line + three_tangents(psi)
        self.by_line, self.w = v.by_line, w
        x = seeded((*w, v.psi, *g0, *g1))
        w, g0, g1 = (Vector(*x[k : k + 3]) for k in (0, 4, 7))
        self.by = rotation_tangents(turned_about(line(w, g0, g1), x[3], g0, g1), 10)
        direct = Matrix(*(0.0 * y for y in self.by[7:]))
        if self.is_momentum:
            direct = Matrix(*(self.f * body.momentum_of(a)[c] * self.by[7 + c] for c, a in enumerate(AXES))).T
        self.set_stages(direct)
        least = LEAST_TURN.get(steps.s, 5e-2)
        self.is_small = self.w @ self.w < least * least
        for _ in when(any_of(self.is_small)):
            if self.is_momentum:
                steps.set_rows(False)
            v.by_step = self.set_by_rows(self.is_small)
        steps.direct[0, 0] = select(self.is_small, 0.0 * direct, direct)
        self.by_step = v.by_step

    def directions(self, body: Body, W: Vector, ahead: Vector) -> tuple[Any, Vector, Vector]:
        """Return one over the size of the momentum, and its direction at both ends."""
        P = body.momentum_of(W)
        f = select(P @ P > FAINT, 1.0 / (sqrt(P @ P) + TINY), 0.0)
        return f, f * P, f * body.momentum_of(ahead)

    def direction(self, V: Vector, g: Any) -> Vector:
        """Return the known vector as seen at a stage."""
        return self.f * self.steps.body.momentum_of(V) if self.is_momentum else g[0]

    def set_stages(self, direct: Matrix) -> None:
        """Set Θ."""
        steps, by = self.steps, self.by
        ends = Matrix(*by[7:]).T
        for i, stage in steps.stages.each():
            b, g = steps.h * steps.weight(i), steps.vectors(stage)
            x = seeded((*stage.V, *[y for v in g for y in v]))
            V, vertical = Vector(*x[:3]), [Vector(*x[3:])] if g else []
            psi = arc(b * V, self.direction(V, vertical), self.r)
            by_velocity = three_tangents(psi) + b * self.by_line
            theta = Matrix(*(b * by[c] + by_velocity[c] * by[3] for c in range(3))).T
            if self.is_momentum:
                theta = theta + direct @ steps.Z[i, 0]
            else:
                by_vector = Vector(*(tangent(psi, 3 + c) for c in range(3)))
                rows = (y * by_vector + b * cross(stage.V, z) for y, z in zip(by[3], ends, strict=True))
                steps.by_end[i, 0] = Matrix(*rows)
                theta = theta + Matrix(*(b * cross(z, stage.g0) for z in ends))
            steps.theta[i, 0] = theta
        if self.is_momentum:
            return
        for j, stage in steps.stages.each():
            v = Variables(theta=steps.theta[j, 0])
            for i in loop(steps.s):
                v.theta = v.theta + Matrix(*(cross(row @ steps.U[i, j], stage.g0) for row in steps.by_end[i, 0]))
            steps.theta[j, 0] = v.theta

    def begin(self, e: StageEquations, W: Vector, count: int) -> None:
        """Begin with the equations in the directions of columns, and W at the beginning."""
        super().begin(e, W, count)
        self.own = self.directions(e.nodes.body, W, self.steps.W[1])
        for k in range(4 * count):
            self.steps.along.memory[k] = 0.0 * self.steps.h

    def add_changes(self, i: Any, stage: View, g: Any) -> None:
        """Take up changes of ψ, and of the vertical at the end."""
        sums, b = self.steps.along, self.known.h * self.steps.weight(i)
        direction = self.own[0] * self.known.body.momentum_of(stage.V) if self.is_momentum else g[0]
        found = [arc(b * stage.V, direction, self.r)]
        if not self.is_momentum:
            found += b * cross(direction, stage.V)
        for j in range(self.count):
            row = sums.row(j)
            for k, x in enumerate(tangent(tuple(found), j)):
                row[k] = row[k] + x

    def changes(self, V: Vector) -> list[Vector]:
        """Return what changes the turn in each direction beside V at the stages."""
        steps, found = self.steps, []
        g0 = self.own[1] if self.is_momentum else self.equations.start[0]
        for j in range(self.count):
            dh, dg0, sums = tangent(self.known.h, j), tangent(g0, j), steps.along.row(j)
            dw = (dh / steps.h) * self.w
            dg1 = tangent(self.own[2], j) if self.is_momentum else dg0 + vector_at(sums, 1)
            theta = 0.0 * self.w
            for x, y in zip((*dw, sums[0] + self.by_line @ dw, *dg0, *dg1), self.by, strict=True):
                theta = theta + x * y
            found.append(select(self.is_small, dh * self.by_step, theta))
        return found


def rotation_tangents(q: Quaternion, count: int) -> list[Vector]:
    """Return the rotation vectors by which the turn of a quaternion of any length changes, in each direction."""
    p = plain(q)
    back = (2.0 / (p[0] * p[0] + p.vector @ p.vector)) * Quaternion(p[0], *(-p.vector))
    return [(back @ tangent(q, j)).vector for j in range(count)]
