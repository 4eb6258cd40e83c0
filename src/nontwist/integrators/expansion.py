"""States between the nodes of a run, where these lie on one trajectory: by power series from both ends of a step.

The equations of `gauss_stages`, run on power series (`kernels.series`) in the part τ of a step, give the momentum P,
the attitude p and the sums of an interval as polynomials: a(τ) from the node where the step begins, b(1 - τ) from that
where it ends. Each is the exact motion through its node, to round-off: as many coefficients are made as that takes. The
error of the step itself puts them apart, by d in its middle. In between the state passes from one to the other,

    x(τ) = a(τ) + w(τ) (b(1 - τ) - a(τ)),        w = u⁴ (35 - 84 u + 70 u² - 20 u³),        u = 5 τ - 2,

with three continuous derivatives, w = 0 where u < 0 and 1 where u > 1. An invariant is the same along a and b, so along
x it is off by d² times its second derivative; d up to `LARGEST_MISMATCH` is taken, otherwise the integrator takes
substeps. The quaternion is normalised. The sums over a whole step are those that the scheme has found, so the balances
of a run hold between outputs as they do between nodes. No series is taken further than the part 0.6 of a step, near
which its weight is small: coefficients that add `LAST` there are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, reduce
from math import inf
from typing import Any, NamedTuple

from ..engine.records import SUMS, Body, Parts, Sums, offsets_of
from ..engine.sampling import Nodes
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.elements import any_of, larger, select, smaller, sqrt
from ..kernels.kernel import Kernel
from ..kernels.machine_code import lanes_of_text
from ..kernels.memory import Doubles, View, Wholes, doubles, fields, put, scratch
from ..kernels.series import Recurrence, Stored
from ..kernels.vectors import Matrix, Quaternion, Vector, attitude, cross, sum_of, taxicab
from .gauss_stages import VECTORS, Equations, Now, StageLoads

FEWEST, MORE, MOST = 10, 3, 43  # coefficients: at first, by how many they rise, at most
PART, LAST, LARGEST_MISMATCH, TINY = 0.6, 4e-14, 1e-7, 1e-300
STATE = 7  # numbers of P and p
UNTIMED = tuple(range(SUMS.work, SUMS.iterations))  # of which a sum is no mean


class Run(NamedTuple):
    """What the kernel is called with: members, their nodes, steps with outputs inside, outputs."""

    first: int  # members
    last: int
    bodies: Doubles
    body_stride: int
    scales: Doubles  # of the loads, in units of the body
    scale_stride: int
    rate: Doubles  # (1,) 1 over the unit of time
    nodes: int
    p: Doubles  # (m, nodes, 4)
    W: Doubles  # (m, nodes, 3)
    means: Doubles  # (m, nodes - 1, `Sums`)
    spans: Doubles  # (nodes - 1,) between nodes, in units of time
    begin: Wholes  # (steps,) the node at which each step begins
    lengths: Doubles  # (steps,) in units of time
    outputs: Wholes  # (steps + 1,) number of the first output inside
    first_rows: Wholes  # (steps,) its row
    parts: Doubles  # τ of the outputs inside
    polynomials: Doubles  # (steps, 2, vectors, 3, degree) loads as polynomials from both ends
    degree: int
    times: Doubles  # (steps, 2) of both ends, those of the caller
    steps_taken: Wholes  # (m,) how many of the steps a member has taken, and its outputs
    good: Wholes
    output_count: int  # of a member, the start the first one
    rows: Wholes  # (outputs,) the node at or before each
    inside: Wholes  # (outputs,) 1 where it lies after it
    intervals: Doubles  # (outputs,) 1 over the time since the output before
    quaternions: Doubles  # (m, outputs, 4)
    velocities: Doubles  # (m, outputs, 3)
    sums: Doubles  # (m, outputs - 1, `Sums`)
    mismatch: Doubles  # (m,) the largest d


RUN = offsets_of(Run)


class AtEnds(Nodes):
    """What acts at the ends of steps: bodies, and the frame that they have there."""

    def __init__(self, parts: Parts, body: Body, p: Quaternion) -> None:
        self.parts, self.body, self.R = parts, body, attitude(p)


def vectors_of(parts: Parts) -> int:
    """Return of how many vectors the loads are polynomials."""
    return parts.moving + parts.space + 2 * parts.rotor


def summed_fields(parts: Parts) -> list[str]:
    """Return what is summed, and is not 0."""
    has_moment = parts.moving or parts.space or parts.rotor or parts.damping
    is_made = {
        "mu": parts.is_constrained,
        "moment": has_moment,
        "dead": parts.is_constrained and parts.dead,
        "work": has_moment,
        "velocity_integral": parts.integrates_velocity,
        "velocity_moment": parts.integrates_velocity,
        "twist": True,
    }
    return [name for name, is_there in is_made.items() if is_there and parts.reports]


def sums_of(parts: Parts) -> list[int]:
    """Return the places in `Sums` of what is summed."""
    return [fields(Sums)[name].offset + k for name in summed_fields(parts) for k in range(fields(Sums)[name].size)]


@lru_cache
def output_kernel(parts: Parts) -> Kernel:
    """Return the kernel that finds the outputs of members."""

    def kernel(address: Any) -> None:
        run = View(Run, doubles(address))
        for i in loop(run.first, run.last):
            run.mismatch[i] = 0.0
            for first in loop(0, run.steps_taken[i], lanes_of_text()):
                find_outputs(parts, run, i, first)
            join(parts, run, i)

    return Kernel(kernel, "i8")


def body_of(run: View, i: Any) -> Body:
    """Return the body of a member."""
    return Body(*View(Body, run.bodies.shifted(i * run.body_stride)).read())


class Arena:
    """Memory for both ends of steps, the same one after the other whenever an expansion is made again."""

    def __init__(self) -> None:
        self._made, self._next, self._side = list[Any](), 0, 0

    def of(self, side: Any) -> Arena:
        """Begin again, for one of the ends."""
        self._next, self._side = 0, side
        return self

    def __call__(self, count: int) -> Any:
        """Return the next memory, of so many numbers."""
        if self._next == len(self._made):
            self._made.append(scratch(2 * count))
        self._next += 1
        return self.at(self._next - 1, self._side, count)

    def at(self, number: int, side: Any, count: int) -> Any:
        """Return that of a number, for one of the ends."""
        return self._made[number].shifted(side * count)


class Expansion:
    """Series of P, p and the sums, in as many steps as there are lanes, from one of their ends."""

    def __init__(self, parts: Parts, run: View, i: Any, side: Any, allocate: Arena) -> None:
        self.parts, self.run, self.i, self.side, self.body = parts, run, i, side, body_of(run, i)
        lanes = self.lanes = lanes_of_text()
        self.recurrence = Recurrence(MOST - 1, lanes=lanes, allocate=allocate)
        self.unknowns = [self.recurrence.unknown() for _ in range(STATE + len(sums_of(parts)))]
        self.rows = [self.recurrence.unknown() for _ in range(3 * VECTORS[parts.motion])]
        self.polynomials = [allocate(MOST * lanes) for _ in range(3 * vectors_of(parts))]
        self.clock = allocate(MOST * lanes if parts.integrates_velocity else 0)
        self.length, self._start = allocate(lanes), allocate(len(self.unknowns) * lanes)

    def read_ends(self, first: Any) -> None:
        """Take what is known at the ends of steps, as many as there are lanes; the last one again and again."""
        run, i, lanes, body, start = self.run, self.i, self.lanes, self.body, self._start
        for memory in (*self.polynomials, *[self.clock][: self.parts.integrates_velocity]):
            for k in loop(MOST * lanes):
                memory[k] = 0.0
        for l in loop(lanes):
            step = smaller(first + l, run.steps_taken[i] - 1)
            begin, length = run.begin[step], run.lengths[step]
            node, means = i * run.nodes + begin, run.means.shifted((i * (run.nodes - 1) + begin) * SUMS.size)
            p, W = run.p.shifted(4 * (node + self.side)), run.W.shifted(3 * (node + self.side))
            sums = [(1.0 if c in UNTIMED else length) * means[c] for c in sums_of(self.parts)]
            numbers = [p[k] for k in range(4)] + [W[k] for k in range(3)]
            for c, x in enumerate([*numbers, *(select(self.side == 0, 0.0, x) for x in sums)]):
                start[c * lanes + l] = x
            self.length[l] = select(self.side == 0, length, -length)
            if self.parts.integrates_velocity:
                second = self.length[l] / run.rate[0]
                self.clock[l], self.clock[lanes + l] = run.times[2 * step + self.side], second
            for c, memory in enumerate(self.polynomials):
                numbers = run.polynomials.shifted(((2 * step + self.side) * len(self.polynomials) + c) * run.degree)
                for n in loop(run.degree):
                    memory[n * lanes + l] = numbers[n]
        x, y, z, w, *more = (start.load(c * lanes, lanes) for c in range(len(self.unknowns)))
        q = Quaternion(w, x, y, z) @ body.frame
        P = body.momentum_of((1.0 / run.rate[0]) * (Vector(*more[:3]) @ body.basis))
        third = select(body.k[2] == 0.0, 0.0, P[2])
        for one, at in zip(self.unknowns, (P[0], P[1], third, *q, *more[3:]), strict=True):
            one.set_coefficient(0, at)
        for one, at in zip(self.rows, (x for v in self.equations().start for x in v), strict=True):
            one.set_coefficient(0, at)

    def equations(self) -> Equations:
        """Return the equations in the frame of the end."""
        P, p = Vector(*self.unknowns[:3]), Quaternion(*(x[0] for x in self.unknowns[3:STATE]))
        return Equations(self.parts.motion, AtEnds(self.parts, self.body, p), None, P)  # type: ignore[arg-type]

    def expand(self, known: Any, k: Any) -> None:
        """Make k coefficients, given the first `known`."""
        P, p, e = Vector(*self.unknowns[:3]), Quaternion(*self.unknowns[3:STATE]), self.equations()
        g = Matrix(*zip(*[iter(self.rows)] * 3, strict=True)) if self.rows else ()
        moving, space, rotor = self.loads()
        space_in_b = None if space is None else space @ e.nodes.R
        now = e.now(StageLoads(moving, space_in_b, rotor), P, g, inverse=lambda C, f: f @ C)
        W, v, w = now.W, p.vector, p[0]
        rates = [*now.rate, (v @ W) * -0.5, *((W * w + cross(v, W)) * 0.5)]
        rates += self.sum_rates(now, p, space)
        for each in g:
            rates += cross(each, W)
        h = self.length.load(0, self.lanes)
        self.recurrence.solve([*self.unknowns, *self.rows], [h * rate for rate in rates], known - 1, k - 1)

    def loads(self) -> tuple[Any, Any, Any]:
        """Return the moment along the frame, that in space, and the momentum of the rotors; None: there is none."""
        body, parts, found = self.body, self.parts, list[Vector]()
        scale = self.run.scales[self.i * self.run.scale_stride]
        for a, b, c in zip(*[iter(self.polynomials)] * 3, strict=True):
            found.append(scale * Vector(*(Stored(self.recurrence, x) for x in (a, b, c))))
        vectors = iter(found)
        moving = next(vectors) @ body.basis if parts.moving else None
        space = next(vectors) if parts.space else None
        rotor = next(vectors) @ body.basis if parts.rotor else None
        if parts.rotor:
            rate = next(vectors) @ body.basis
            moving = -rate if moving is None else moving - rate
        return moving, space, rotor

    def sum_rates(self, now: Now, p: Quaternion, space: Any) -> list[Any]:
        """Return the rates of the sums: μ, the moment and that of dead forces in space, work, W, t W and twist."""
        body, parts, found, names = self.body, self.parts, list[Any](), summed_fields(self.parts)
        (b0, b1), k = body.off, body.k
        if "mu" in names:
            found.append(now.torque[2] - (b0 * k[0]) * now.rate[0] - (b1 * k[1]) * now.rate[1])
        if "moment" in names:
            found += sum_of(None if now.own is None else p.rotate(now.own), space)
        if "dead" in names:
            found += p.rotate(now.still)
        if "work" in names:
            found.append(sum_of(*(None if x is None else now.W @ x for x in (now.own, now.push))))
        if not parts.reports:
            return []
        turning = body.basis @ now.W if parts.integrates_velocity else ()
        velocity_moment = [Stored(self.recurrence, self.clock) * x for x in turning]
        return [*(body.unit * x for x in found), *turning, *velocity_moment, body.axis @ now.W]


def find_outputs(parts: Parts, run: View, i: Any, first: Any) -> None:
    """Find the outputs of a member in as many steps as there are lanes, from number `first` on."""
    lanes, count = lanes_of_text(), STATE + len(sums_of(parts))
    arena, (signs, mismatch, rest, enough) = Arena(), (scratch(lanes) for _ in range(4))
    enough = enough.shifted(0, True)
    for _ in range(count):
        arena(MOST * lanes)
    series = [[arena.at(c, side, MOST * lanes) for c in range(count)] for side in range(2)]
    for l in loop(lanes):
        enough[l] = 0
    v = Variables(k=FEWEST, known=1, power=PART**FEWEST, goes=True)
    for _ in whilst(lambda: v.goes):
        for side in loop(2):
            e = Expansion(parts, run, i, side, arena.of(side))
            for _ in when(v.known == 1):
                e.read_ends(first)
            e.expand(v.known, v.k)
        rest.store(0, v.power * rest_of(series, v.k), lanes)
        v.known, v.goes = v.k, False
        for l in loop(lanes):
            for _ in when(enough[l] == 0):
                for _ in when(rest[l] <= LAST):
                    enough[l] = v.k
                v.goes = v.goes | (enough[l] == 0)
        v.goes = v.goes & (v.k < MOST)
        for _ in when(v.goes):
            v.k, v.power = v.k + MORE, PART**MORE * v.power
    a, b = (at_middle(each[:STATE], v.k) for each in series)
    dot = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    sign = select(dot < 0.0, -1.0, 1.0)
    d = [x - y for x, y in zip(a, (*b[:3], *(sign * y for y in b[3:])), strict=True)]
    off = larger(taxicab(d) / (taxicab(a) + TINY), taxicab(d[3:]) + abs(d[6]))
    signs.store(0, sign, lanes)
    mismatch.store(0, select(off <= inf, off, inf), lanes)
    for l in loop(smaller(run.steps_taken[i] - first, lanes)):
        run.mismatch[i] = larger(run.mismatch[i], select(enough[l] == 0, inf, mismatch[l]))
        ends = [[one.shifted(l) for one in each] for each in series]
        write_outputs(parts, run, i, ends, enough[l], first + l, signs[l])


def rest_of(series: list[Any], k: Any) -> Any:
    """Return the size of the last two coefficients of P, over that of P, and of p."""
    lanes = lanes_of_text()

    def coefficients(n: Any) -> Iterator[list[Any]]:
        return ([one.load(n * lanes, lanes) for one in each[:STATE]] for each in series)

    P = reduce(larger, map(taxicab, coefficients(0))) + TINY
    last = [x for n in (k - 1, k - 2) for x in coefficients(n)]
    return reduce(larger, (taxicab(x) / P + taxicab(x[3:]) + abs(x[6]) for x in last))


def at_middle(series: list[Any], k: Any) -> Any:
    """Return polynomials of k coefficients in the middle of steps."""
    lanes = lanes_of_text()
    v = Variables(x=tuple(one.load((k - 1) * lanes, lanes) for one in series))
    for n in loop(2, k + 1):
        v.x = tuple(0.5 * x + one.load((k - n) * lanes, lanes) for x, one in zip(v.x, series, strict=True))
    return v.x


def write_outputs(parts: Parts, run: View, i: Any, series: Any, k: Any, step: Any, sign: Any) -> None:
    """Write the outputs inside of a step of a member."""
    lanes, sums, body, count = lanes_of_text(), sums_of(parts), body_of(run, i), len(series[0])
    out, signs = scratch(count * lanes), [sign if 3 <= c < STATE else 1.0 for c in range(count)]
    begin, end = run.outputs[step], run.outputs[step + 1]
    for number in loop(begin, end, lanes):
        t = run.parts.load(number, lanes)
        s, zero = 1.0 - t, 0.0 * t
        v = Variables(a=(zero,) * count, b=(zero,) * count)
        for name, part, ends in (("a", t, series[0]), ("b", s, series[1])):
            for _ in when(any_of(part < PART)):
                for n in loop(1, k + 1):
                    x, at = getattr(v, name), (k - n) * lanes
                    setattr(v, name, tuple(y * part + one[at] for y, one in zip(x, ends, strict=True)))
        u = smaller(larger((t - (1.0 - PART)) * (1.0 / (2.0 * PART - 1.0)), 0.0), 1.0)
        weight = u * u * u * u * (35.0 - u * (84.0 - u * (70.0 - u * 20.0)))
        x = [a + weight * (f * b - a) for a, b, f in zip(v.a, v.b, signs, strict=True)]
        p = Quaternion(*x[3:STATE])
        q = (1.0 / sqrt(sum_of(*(y * y for y in p)))) * p @ body.frame.inverse
        W = run.rate[0] * (body.basis @ body.velocity_of(Vector(*x[:3])))
        for c, y in enumerate((*q.vector, q[0], *W, *x[STATE:])):
            out.store(c * lanes, y, lanes)
        for l in loop(smaller(end - number, lanes)):
            row = i * run.output_count + run.first_rows[step] + (number - begin) + l
            target, found = run.sums.shifted((row - i - 1) * SUMS.size), tuple(out[c * lanes + l] for c in range(count))
            put(run.quaternions, found[:4], 4 * row)
            put(run.velocities, found[4:STATE], 3 * row)
            for place, y in zip(sums, found[STATE:], strict=True):
                target[place] = y


def join(parts: Parts, run: View, i: Any) -> None:
    """Write the outputs at nodes, and means over the intervals between outputs; give quaternions their signs."""
    v, total, own = Variables(row=0), scratch(SUMS.size), sums_of(parts)
    for c in range(SUMS.size):
        total[c] = 0.0
    for number in loop(run.good[i]):
        row, inside, at = run.rows[number], run.inside[number], i * run.output_count + number
        q, W = run.quaternions.shifted(4 * at), run.velocities.shifted(3 * at)
        sums = run.sums.shifted((at - i - 1) * SUMS.size)
        for _ in when(inside == 0):
            for target, source, n in ((q, run.p, 4), (W, run.W, 3)):
                put(target, tuple(source[(i * run.nodes + row) * n + c] for c in range(n)))
        for _ in when(number > 0):
            before = q.shifted(-4)
            for _ in when(before[0] * q[0] + before[1] * q[1] + before[2] * q[2] + before[3] * q[3] < 0.0):
                put(q, tuple(-q[c] for c in range(4)))
            if own:
                for node in loop(v.row, row + inside):
                    means = run.means.shifted((i * (run.nodes - 1) + node) * SUMS.size)
                    total[SUMS.iterations] = larger(total[SUMS.iterations], means[SUMS.iterations])
                    for c in own:
                        by = 1.0 if c in UNTIMED else run.spans[node]
                        total[c] = total[c] + select(node < row, by * means[c], 0.0)
                for c in own:
                    x = select(inside == 0, 0.0, sums[c])
                    sums[c] = (total[c] + x) * (1.0 if c in UNTIMED else run.intervals[number])
                    total[c] = -x
                sums[SUMS.iterations] = total[SUMS.iterations]
                total[SUMS.iterations] = 0.0
        v.row = row
