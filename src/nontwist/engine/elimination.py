"""Systems of linear equations, one for each lane, by Gauss's elimination with partial pivots."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels.control import loop, when
from ..kernels.elements import any_of, fma, select
from ..kernels.parts import part
from ..kernels.tracing import width


class Room(NamedTuple):
    """Numbers in memory, one for each lane."""

    memory: Any
    lanes: int

    def shifted(self, k: Any) -> Room:
        """Return the room that begins k numbers further."""
        return Room(self.memory.shifted(k * self.lanes), self.lanes)

    def __getitem__(self, k: Any) -> Any:
        return self.memory.load(k * self.lanes, self.lanes)

    def __setitem__(self, k: Any, x: Any) -> None:
        self.memory.store(k * self.lanes, x, self.lanes)


@part
def eliminate(a: Room, m: Any, columns: Any) -> None:
    """Replace the columns behind the m-th of m rows by the solutions, for each as right-hand side.

    m is a multiple of three: rows go by threes, so that what is loaded serves several products.
    """

    def lessen(i: Any, p: Any, first: Any) -> None:
        """Take multiples of the rows p, p + 1, p + 2 from three rows i, which hold them from the column p on."""
        f = [[-a[(i + r) * columns + p + k] for k in range(3)] for r in range(3)]
        for j in loop(first, columns):
            u = [a[(p + k) * columns + j] for k in range(3)]
            for r in range(3):
                at = (i + r) * columns + j
                a[at] = fma(f[r][0], u[0], fma(f[r][1], u[1], fma(f[r][2], u[2], a[at])))

    for p in loop(0, m, 3):
        for c in range(3):
            k = p + c
            for i in loop(k + 1, m):
                swaps = abs(a[i * columns + k]) > abs(a[k * columns + k])
                for _ in when(any_of(swaps)):
                    for j in loop(p, columns):
                        u, v = a[k * columns + j], a[i * columns + j]
                        a[k * columns + j], a[i * columns + j] = select(swaps, v, u), select(swaps, u, v)
            f = 1.0 / a[k * columns + k]
            for i in loop(k + 1, m):
                g = f * a[i * columns + k]
                a[i * columns + k] = g
                for j in range(c + 1, 3):
                    at = i * columns + p + j
                    a[at] = fma(-g, a[k * columns + p + j], a[at])
        f, g, h = a[(p + 1) * columns + p], a[(p + 2) * columns + p], a[(p + 2) * columns + p + 1]
        for j in loop(p + 3, columns):
            u, at, to = a[p * columns + j], (p + 1) * columns + j, (p + 2) * columns + j
            v = fma(-f, u, a[at])
            a[at], a[to] = v, fma(-h, v, fma(-g, u, a[to]))
        for i in loop(p + 3, m, 3):
            lessen(i, p, p + 3)
    for back in loop(0, m, 3):
        p = m - 3 - back
        d = [1.0 / a[(p + k) * columns + p + k] for k in range(3)]
        f, g, h = a[p * columns + p + 1], a[p * columns + p + 2], a[(p + 1) * columns + p + 2]
        for j in loop(m, columns):
            at = [(p + k) * columns + j for k in range(3)]
            w = d[2] * a[at[2]]
            v = d[1] * fma(-h, w, a[at[1]])
            a[at[0]], a[at[1]], a[at[2]] = d[0] * fma(-f, v, fma(-g, w, a[at[0]])), v, w
        for i in loop(0, p, 3):
            lessen(i, p, m)
