"""Systems of linear equations, one for each lane, by Gauss's elimination with partial pivots."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import any_of, fma, select
from ..kernels.kernel import part


class Scratch(NamedTuple):
    """Numbers in memory, one for each lane."""

    memory: Any
    lanes: int

    def shifted(self, k: Any) -> Scratch:
        """Return the memory that begins k numbers further."""
        return Scratch(self.memory.shifted(k * self.lanes), self.lanes)

    def __getitem__(self, k: Any) -> Any:
        return self.memory.load(k * self.lanes, self.lanes)

    def __setitem__(self, k: Any, x: Any) -> None:
        self.memory.store(k * self.lanes, x, self.lanes)


def eliminate_once(a: Scratch, m: int, columns: int) -> None:
    """Let the elimination stand once in the code, whatever the sizes."""
    v = Variables(m=m, columns=columns)
    eliminate(a, v.m, v.columns)


@part
def eliminate(a: Scratch, m: Any, columns: Any) -> None:
    """Replace the columns behind the m-th of m rows by the solutions, for each as right-hand side.

    m is a multiple of three: rows go by threes, so that what is loaded serves several products.
    """

    def row(i: Any) -> Scratch:
        return a.shifted(i * columns)

    def lessen(i: Any, p: Any, first: Any) -> None:
        """Take multiples of the rows p, p + 1, p + 2 from three rows i, which hold them from the column p on."""
        pivots, rows = [row(p + k) for k in range(3)], [row(i + k) for k in range(3)]
        f = [[-own[p + k] for k in range(3)] for own in rows]
        for j in loop(first, columns):
            u = [own[j] for own in pivots]
            for own, g in zip(rows, f, strict=True):
                own[j] = fma(g[0], u[0], fma(g[1], u[1], fma(g[2], u[2], own[j])))

    for p in loop(0, m, 3):
        for c in range(3):
            k, pivot = p + c, row(p + c)
            for i in loop(k + 1, m):
                own = row(i)
                swaps = abs(own[k]) > abs(pivot[k])
                for _ in when(any_of(swaps)):
                    for j in loop(p, columns):
                        u, v = pivot[j], own[j]
                        pivot[j], own[j] = select(swaps, v, u), select(swaps, u, v)
            f = 1.0 / pivot[k]
            for i in loop(k + 1, m):
                own = row(i)
                own[k] = f * own[k]
                for j in range(c + 1, 3):
                    own[p + j] = fma(-own[k], pivot[p + j], own[p + j])
        r0, r1, r2 = (row(p + k) for k in range(3))
        f, g, h = r1[p], r2[p], r2[p + 1]
        for j in loop(p + 3, columns):
            u = r0[j]
            v = fma(-f, u, r1[j])
            r1[j], r2[j] = v, fma(-h, v, fma(-g, u, r2[j]))
        for i in loop(p + 3, m, 3):
            lessen(i, p, p + 3)
    for back in loop(0, m, 3):
        p = m - 3 - back
        r0, r1, r2 = (row(p + k) for k in range(3))
        d0, d1, d2 = 1.0 / r0[p], 1.0 / r1[p + 1], 1.0 / r2[p + 2]
        f, g, h = r0[p + 1], r0[p + 2], r1[p + 2]
        for j in loop(m, columns):
            w = d2 * r2[j]
            v = d1 * fma(-h, w, r1[j])
            r0[j], r1[j], r2[j] = d0 * fma(-f, v, fma(-g, w, r0[j])), v, w
        for i in loop(0, p, 3):
            lessen(i, p, m)
