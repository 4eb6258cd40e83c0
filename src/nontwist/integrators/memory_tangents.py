"""Derivatives of steps under loads with memory: the variational equation, collocated at the known stages.

With R the rows of Λ, z the momenta h of wheels and the internal states of other loads (`loads.memory_terms`),
and Q the inverse of the carrier's inertia, across a constrained axis, the equations of `gauss` are x' = G(t, x, u):

    R' = R Ŵ,        W' = Q ((J_c W + Σ h n) × W + M(t, R, W, z) - Σ h' n) + s' v,        z' = f(t, R, W, z),

u parameters of wheels, s a prescribed spin about n, and ``v = J_c⁻¹ n/(n·J_c⁻¹ n)``. J_c is a parameter as well, by
which W' changes by ``Q (dJ_c W × W - dJ_c W')``. Of a gravity gradient in M the inertia is that of the whole body. It
changes with that of its carrier, and not with those of wheels. A step from x_n has stages ``X_i = x_n + k Σ a_ij
G(X_j)``, k its length, and the end ``x_n + k Σ b_j G(X_j)``. Derivatives of both obey the same equations, linear, with
∂G/∂x and ∂G/∂u at the stages:

    dX_i = dx_n + k Σ a_ij (G_x dX_j + G_u du),        dx_{n+1} = dx_n + k Σ b_j (G_x dX_j + G_u du).

They are the derivatives of the computed step, not those of the motion. As stages are not stored, they are found again
by Newton's iteration with the same matrix, many steps at a time. At nodes R is a rotation, and dR = R δ̂. All wheels
are states here, also those whose momentum is known beforehand: h is then a polynomial that is collocated.

A step of `lie_midpoint` is that of one stage, but for dead forces: it takes Λ_m⁻¹ Σ d_{i,m} × f^i, and `gauss` Σ e_i ×
Λ_mᵀ f^i, which differ where Λ_m is no rotation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..engine.called_functions import changes_of_numbers
from ..engine.generalised import TERM, moment_of
from ..geometry.arrays import Array
from ..geometry.attitudes import States, attitudes
from ..kernels.dual import Dual, plain, tangent
from ..kernels.vectors import Matrix, Vector, cross, first_moment
from ..loads import Load
from ..loads.functions import MOMENTS, differentiated
from ..loads.load import is_called, tables_as_moments
from ..loads.load_derivatives import derivatives_of_columns
from ..loads.memory_terms import Memory, Wheel
from ..loads.potentials import ForceTable, GravityGradient, OfOneVector, Potential
from .compiled import Compiled
from .gauss_coefficients import matrix, nodes, weights
from .gauss_stages import pulled_back
from .ivp import IVP
from .linearised_runs import ranged, unsolved_step
from .load_samples import as_marched, at_nodes, carrier, wheel_columns, with_spin

AXES, NO_MATRIX = np.eye(3), Matrix(*([0.0] * 3,) * 3)
MOST = 2**20  # numbers of the matrices that are made at a time
ITERATIONS, CLOSE, NEAR = 30, 1e-11, 1e-6  # of Newton's; the last change; how near an end is to the one that is known
ROWS, ATTITUDE = 12, 9  # numbers of R and W, of R
FIELDS = ("speed", "torque", "viscous", "inertia", "wheel")  # of wheels
NAMES = (
    f"material_angular_velocity, rotation, inertia, principal_inertia, {', '.join(FIELDS)} of wheels, and fields of "
    "loads with memory of one's own"
)


def require_derivatives(problem: IVP, scheme: Compiled) -> None:
    """Raise a ValueError where a problem with memory has no derivatives."""
    _, load = as_marched(problem, False)
    for term in load.potentials:
        if scheme.text("").is_midpoint and not isinstance(term, OfOneVector):
            raise ValueError(
                f"runs of {scheme.name} with memory have no derivatives beside "
                f"{type(term).words(term.description)}; use gauss"
            )


class RememberingSteps:
    """The steps of a run with memory, linearised.

    Parameters
    ----------
    problem : IVP
    scheme : `gauss` or `lie_midpoint`
    parameters : a load's number, wheels first, the name of a field, and the component; None: of the start or the body
    inertias : (count, 3, 3) array, changes of J_c by the parameters

    Attributes
    ----------
    rows : int
        Numbers of a change: δ, W, z.
    """

    def __init__(
        self, problem: IVP, scheme: Compiled, parameters: list[tuple[int, str, int] | None], inertias: Array
    ) -> None:
        require_derivatives(problem, scheme)
        self.problem, self.parameters, self.inertias = problem.member(0), parameters, inertias
        systems, load = as_marched(self.problem, False)
        load, self.s = tables_as_moments(load), scheme.order // 2
        self.c, self.b, self.is_midpoint = nodes(scheme.order), weights(scheme.order), scheme.text("").is_midpoint
        self.a = self.b * matrix(scheme.order)
        found = list(wheel_columns(load))
        self.wheels = [one.unscaled for one, _ in found]
        self.rest = [term for term in load.remembering if not isinstance(term, Wheel)]
        count = load.internal_state.size - sum(term.state0.size for term in self.rest)
        self.columns = [place for _, place in found] + list(range(count, load.internal_state.size))
        self.load = Load(tuple(term for term in load.terms if not isinstance(term, Memory)))
        self.called = [term for term in self.load.terms if is_called(term)]
        self.damping, self.dead = Matrix(*load.damping.tolist()), Matrix(*systems.dead_force[0].tolist())
        body = carrier(systems[0], load) if self.wheels else systems[0]
        J, Q = body.convected_inertia, np.linalg.inv(body.convected_inertia)
        self.spin, along = self.problem.system.spin, np.zeros(3)
        if (n := body.axis) is not None:
            along = Q @ n / (n @ Q @ n)
            Q = Q - np.outer(Q @ n, along)
        self.along, self.J, self.Q = Vector(*along.tolist()), Matrix(*J.tolist()), Matrix(*Q.tolist())
        self.size, self.rows = ROWS + len(self.columns), 6 + len(self.columns)
        self.sizes = load.internal_scale[self.columns]
        self.scales = [one.scale for one, _ in found]

    # ---- the equations

    def rates(self, t: Array, x: Array, given: Array) -> tuple[Array, Array]:
        """Return G at (N,) times and states (N, size), and its derivatives by states and parameters.

        `given` are moments along the frame and in space, the momentum of the rotors, and the rate of the spin, (N, 10).
        """
        count = self.size + len(self.parameters)
        units = np.eye(count).tolist()
        y = [Dual(column, unit) for column, unit in zip(x.T, units, strict=False)]
        changes = [Dual(0.0 * t, unit) for unit in units[self.size :]]
        R, W, z = Matrix(y[:3], y[3:6], y[6:ATTITUDE]), Vector(*y[ATTITUDE:ROWS]), iter(y[ROWS:])
        time, *known = (Dual(column, [0.0] * count) for column in (t, *given.T))
        moving, push, rotor = (Vector(*known[3 * k : 3 * k + 3]) for k in range(3))
        each = zip(self.inertias, changes, self.parameters, strict=True)
        of_inertia = [(Matrix(*d.tolist()) * by, one) for d, by, one in each if d.any()]
        dJ = sum((d for d, _ in of_inertia), NO_MATRIX)
        dJ_of_body = sum((d for d, one in of_inertia if one is None), NO_MATRIX)
        total, torque, rates = (self.J + dJ) @ W + rotor, moving - self.damping @ W, list[Any]()
        for k, wheel in enumerate(self.wheels):
            own, h = wheel._copy(**self._varied(k, wheel, changes)), next(z)
            n, (rate, *_) = Vector(*own.wheel), own.responses(_called, time, (h,), None, W)[1]
            total, torque, rates = total + h * n, torque - rate * n, [*rates, rate]
        for k, term in enumerate(self.rest, len(self.wheels)):
            own_z = [next(z) for _ in term.state0]
            found = self._with_changes(k, term, changes).text(
                _called, [*(x for d in R.T for x in d), *(R @ W), *W, *own_z, time]
            )
            push, torque = push + term.scale * Vector(*found[:3]), torque + term.scale * Vector(*found[3:MOMENTS])
            rates += found[MOMENTS:]
        for in_space, in_body in self.beside(t, R, W, time, dJ_of_body):
            push, torque = push + in_space, torque + in_body
        torque = torque + cross(total, W)
        if self.is_midpoint:
            push = push + moment_of(R.T, self.dead)
        else:
            torque = torque + first_moment(Matrix(*(force @ R for force in self.dead)))
        free = self.Q @ (torque + pulled_back(R, push)) + known[9] * self.along
        made = [*(c for row in R for c in cross(row, W)), *(free - self.Q @ (dJ @ free)), *rates]
        values = np.stack([np.broadcast_to(plain(one), t.shape) for one in made], axis=1)
        return values, derivatives_of_columns(made, count, len(t))

    def beside(self, t: Array, R: Matrix, W: Vector, time: Dual, dJ: Matrix) -> Iterator[tuple[Vector, Vector]]:
        """Yield the moments in space, and along the frame, of what else depends on the state, given the change of J."""
        zero = 0.0 * W
        for term in self.called:
            if isinstance(term, Potential):
                yield from self._of_potential(term, t, R, dJ, zero)
                continue
            if isinstance(term, ForceTable):  # in space; those along the directors are moments
                found: Any = [zero[0] + x for x in term.samples(t).T]
            else:
                found = term.text(_called, [*(x for d in R.T for x in d), *(R @ W), time])
            is_moment = term.kind != "forces"
            push = Vector(*found) if is_moment else moment_of(R.T, Matrix(found[:3], found[3:6], found[6:]))
            yield term.scale * push, zero

    def _of_potential(
        self, term: Potential, t: Array, R: Matrix, dJ: Matrix, zero: Vector
    ) -> Iterator[tuple[Vector, Vector]]:
        """Yield those of each vector of a potential: of the forces ``-a ∂V/∂γ_j``, or γ × ∂V/∂γ (`generalised`)."""
        if isinstance(term, GravityGradient):
            term = term.of_body(Matrix(*term.inertia.tolist()) + dJ)  # type: ignore[arg-type]
        known = np.moveaxis(np.broadcast_to(term.vectors_at(t), (len(t), *term.vectors.shape)), 0, -1)
        vectors = [Vector(*(zero[0] + x for x in a)) for a in known]
        seen = [a @ R for a in vectors]
        gradient = iter(term.gradient_text(_called, [x for gamma in seen for x in gamma]))
        for a, gamma in zip(vectors, seen, strict=True):
            g = term.scale * Vector(*(next(gradient) for _ in range(3)))
            yield (cross(a, R @ g), zero) if self.is_midpoint else (zero, cross(gamma, g))

    def _varied(self, number: int, wheel: Wheel, changes: list[Any]) -> dict[str, Any]:
        """Return the fields of a wheel that are parameters, with their changes."""
        found, n = dict[str, Any](), wheel.direction
        for one, by in zip(self.parameters, changes, strict=True):
            if one is None or one[0] != number or one[1] == "speed":
                continue
            name, k = one[1:]
            if name == "wheel":  # of a change of the axis counts what is across it
                across = (AXES - np.outer(n, n))[k].tolist()
                found[name] = [x + c * by for x, c in zip(found.get(name, n.tolist()), across, strict=True)]
            else:
                found[name] = getattr(wheel, name) + by * (self.scales[number] if name == "torque" else 1.0)
        return found

    def _with_changes(self, number: int, term: Memory, changes: list[Any]) -> Memory:
        """Return a term that is no wheel with the changes of its fields that are parameters."""
        numbers: list[Any] = term.numbers
        for one, by in zip(self.parameters, changes, strict=True):
            if one is not None and one[0] == number:
                along = changes_of_numbers(term, one[1])[one[2], TERM.own :].tolist()
                numbers = [x + c * by for x, c in zip(numbers, along, strict=False)]
        return term.with_numbers(numbers)

    # ---- steps

    def matrices(self, states: States, back: bool = False) -> Iterator[tuple[slice, Array, Array]]:
        """Yield steps, the derivatives of their ends by their beginnings, and by parameters, given all nodes."""
        n = max(MOST // (self.s * self.size) ** 2, 1)
        for first, last in ranged(self.problem.steps, n, back):
            yield self._part(states, first, last)

    def _part(self, states: States, first: int, last: int) -> tuple[slice, Array, Array]:
        problem, s, q, n = self.problem, self.s, self.size, last - first
        k = np.arange(first, last)
        h = problem.step_at(k)
        times, ends = problem.nodes(k, self.c), slice(first, last + 1)
        moving, space = self.load.sample(times, "body"), self.load.sample(times, "space")
        rotor = np.zeros((n * s, 6))
        if self.load.rotors:
            rotor = at_nodes(self.load, problem.times(k), problem.times(k + 1), h, self.c, 1.0)
        spin = (
            np.zeros(n) if self.spin is None else np.diff(self.spin.at(problem.times(np.arange(first, last + 1)))) / h
        )
        given = np.concatenate([moving - rotor[:, 3:], space, rotor[:, :3], np.repeat(spin, s)[:, None]], axis=1)
        R, z = attitudes(states.quaternion[ends]), states.internal
        assert z is not None
        known = np.concatenate([R.reshape(-1, ATTITUDE), states.velocity[ends], z[ends][:, self.columns]], axis=1)
        X = known[:-1, None] + self.c[:, None] * np.diff(known, axis=0)[:, None]
        ah = h[:, None, None] * self.a
        speed = max(abs(states.velocity).max(), 1 / float(problem.t_end - problem.t_start))
        size = np.concatenate(
            [np.ones(ATTITUDE), np.full(3, speed), np.maximum(self.sizes, abs(known[:, ROWS:]).max(0))]
        )
        for _ in range(ITERATIONS):
            G, slopes = (y.reshape(n, s, q, *y.shape[2:]) for y in self.rates(times, X.reshape(n * s, q), given))
            A = np.eye(s * q) - np.einsum("nij,njkl->nikjl", ah, slopes[..., :q]).reshape(n, s * q, s * q)
            left = known[:-1, None] + np.einsum("nij,njk->nik", ah, G) - X
            d = np.linalg.solve(A, left.reshape(n, s * q, 1)).reshape(n, s, q)
            X, change = X + d, (abs(d) / size).max()
            if change <= CLOSE:
                break
        ends = known[:-1] + h[:, None] * np.einsum("j,njk->nk", self.b, G)
        near = abs(ends - known[1:]) <= NEAR * size
        if not (change <= CLOSE and near.all()):
            bad = first + int(np.argmin(near.all(axis=1)))
            raise unsolved_step(problem, bad)
        p = len(self.parameters)
        start = np.zeros((n, q, self.rows + p))  # δ, W, z, parameters
        for j, axis in enumerate(AXES):
            start[:, :ATTITUDE, j] = np.cross(R[:-1], axis).reshape(n, ATTITUDE)
        start[:, ATTITUDE:, 3 : self.rows] = np.eye(q - ATTITUDE)
        own = np.zeros((n, s, q, self.rows + p))
        own[..., self.rows :] = slopes[..., q:]
        right = start[:, None] + np.einsum("nij,njkl->nikl", ah, own)
        dX = np.linalg.solve(A, right.reshape(n, s * q, -1)).reshape(right.shape)
        change_of_rates = np.einsum("njkl,njlm->njkm", slopes[..., :q], dX) + own
        end = start + h[:, None, None] * np.einsum("j,njkm->nkm", self.b, change_of_rates)
        turns = np.einsum("nxi,nxjm->nijm", R[1:], end[:, :ATTITUDE].reshape(n, 3, 3, -1))
        turn = np.stack([turns[:, i, j] - turns[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1) / 2
        found = np.concatenate([turn, end[:, ATTITUDE:]], axis=1)
        return slice(first, last), found[..., : self.rows], found[..., self.rows :]

    # ---- runs

    def start(self, first: Array) -> Array:
        """Return the changes of the first state, given those of attitude and W, (6, count): speeds are given."""
        found = np.zeros((self.rows, first.shape[1]))
        found[:6] = first
        for k, wheel in enumerate(self.wheels):
            found[6 + k] = wheel.inertia * (wheel.direction @ first[3:6])
            for j, one in enumerate(self.parameters):
                if one is not None and one[0] == k:
                    found[6 + k, j] += self._change_at_start(k, *one[1:])
        place, count = 6 + len(self.wheels), len(self.parameters)
        for k, term in enumerate(self.rest, len(self.wheels)):
            own = self._with_changes(k, term, [Dual(0.0, unit) for unit in np.eye(count).tolist()])
            for z in own.state0:
                found[place] = [tangent(z, j) for j in range(count)]
                place += 1
        return found

    def _change_at_start(self, number: int, name: str, k: int) -> float:
        """Return the change of h at the start by a field of its wheel, or by a component of its axis."""
        wheel, problem = self.wheels[number], self.problem
        n, W = wheel.direction, with_spin(problem.systems, problem.velocity, problem.t_start)[0]
        if name == "speed":
            return wheel.inertia * self.scales[number]
        if name == "inertia":
            return float(wheel.speed + n @ W)
        return wheel.inertia * float(W[k] - n[k] * (n @ W)) if name == "wheel" else 0.0

    def forward(self, states: States, start: Array, directions: Array, is_stored: NDArray[np.int64]) -> Array:
        """Return the changes of attitude and W at the ends of the stored steps, (stored, 6, count)."""
        x, found = start, list[Array]()
        for steps, by_state, by_parameter in self.matrices(states):
            for k, (A, B) in enumerate(zip(by_state, by_parameter @ directions, strict=True)):
                x = A @ x + B
                if is_stored[steps.start + k]:
                    found.append(x[:6])
        return np.array(found).reshape(-1, 6, start.shape[1])

    def back(self, states: States, slopes: Array, is_stored: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the derivatives of f by the first state and by parameters, from those at the ends of stored steps."""
        x, found, left = np.zeros(self.rows), np.zeros(len(self.parameters)), len(slopes)
        for steps, by_state, by_parameter in self.matrices(states, True):
            for k in reversed(range(len(by_state))):
                if is_stored[steps.start + k]:
                    left -= 1
                    x[:6] += slopes[left]
                found += by_parameter[k].T @ x
                x = by_state[k].T @ x
        return x, found


def _called(function: Callable[..., Any], given: tuple[Any, ...], shape: tuple[int, ...]) -> list[Any]:
    """Call a function with duals of arrays, or, where it does not take them, with one number after the other."""
    numbers = [one for x in given for one in np.ravel(np.array(x, dtype=object)).tolist()]
    count = len(plain(numbers[0]))
    try:
        return differentiated(function, given, shape)
    except ValueError:
        each = [differentiated(function, tuple(_at_one(x, k) for x in given), shape) for k in range(count)]
    return [_dual_array(list(found), numbers[0]) for found in zip(*each, strict=True)]


def _at_one(x: Any, k: int) -> Any:
    """Return the number k of duals of arrays."""
    if isinstance(x, np.ndarray):
        return np.array([_at_one(y, k) for y in x.ravel()], dtype=object).reshape(x.shape)
    return Dual(float(x.value[k]), [d if isinstance(d, float) else float(d[k]) for d in x.tangents])


def _dual_array(each: list[Any], like: Dual) -> Dual:
    """Return duals of numbers as one of arrays."""
    count = len(like.tangents)
    tangents = [np.array([y.tangents[j] if isinstance(y, Dual) else 0.0 for y in each]) for j in range(count)]
    return Dual(np.array([float(plain(y)) for y in each]), tangents)
