"""Systems of linear equations in elements: eight at a time, by Gauss's elimination."""

from ..geometry.compiled import inlined, shared
from ..geometry.elements import any_of, fused, lanes, load, select, shifted, store


@inlined
def lessened(x, i, p, first, last, column, width, one):
    """Take multiples of the rows p, p + 1, p + 2 from the rows i, i + 1, i + 2, which hold them from `column` on."""
    n = lanes(one)
    g0, g1, g2 = (i * width + column) * n, ((i + 1) * width + column) * n, ((i + 2) * width + column) * n
    f = (-load(x, g0, one), -load(x, g0 + n, one), -load(x, g0 + 2 * n, one))
    g = (-load(x, g1, one), -load(x, g1 + n, one), -load(x, g1 + 2 * n, one))
    h = (-load(x, g2, one), -load(x, g2 + n, one), -load(x, g2 + 2 * n, one))
    for j in range(first, last):
        at, to = (p * width + j) * n, (i * width + j) * n
        u = (load(x, at, one), load(x, at + width * n, one), load(x, at + 2 * width * n, one))
        store(x, to, fused(f[0], u[0], fused(f[1], u[1], fused(f[2], u[2], load(x, to, one)))))
        to = to + width * n
        store(x, to, fused(g[0], u[0], fused(g[1], u[1], fused(g[2], u[2], load(x, to, one)))))
        to = to + width * n
        store(x, to, fused(h[0], u[0], fused(h[1], u[1], fused(h[2], u[2], load(x, to, one)))))


@shared
def eliminated(x, place, m, width, one):
    """Replace the columns after the m-th of m rows by the solutions, for each as right-hand side; pivots by lane.

    Rows go by threes, so that what is loaded serves several products.
    """
    n = lanes(one)
    x = shifted(x, place * n)
    for p in range(0, m, 3):
        for k in range(p, p + 3):
            for i in range(k + 1, m):
                swaps = abs(load(x, (i * width + k) * n, one)) > abs(load(x, (k * width + k) * n, one))
                if any_of(swaps):
                    for j in range(p, width):
                        u, v = load(x, (k * width + j) * n, one), load(x, (i * width + j) * n, one)
                        store(x, (k * width + j) * n, select(swaps, v, u))
                        store(x, (i * width + j) * n, select(swaps, u, v))
            f = 1.0 / load(x, (k * width + k) * n, one)
            for i in range(k + 1, m):
                g = f * load(x, (i * width + k) * n, one)
                store(x, (i * width + k) * n, g)
                for j in range(k + 1, p + 3):
                    store(
                        x,
                        (i * width + j) * n,
                        fused(-g, load(x, (k * width + j) * n, one), load(x, (i * width + j) * n, one)),
                    )
        at = (p * width + p) * n
        f, g, h = load(x, at + width * n, one), load(x, at + 2 * width * n, one), load(x, at + (2 * width + 1) * n, one)
        for j in range(p + 3, width):
            at = (p * width + j) * n
            u = load(x, at, one)
            v = fused(-f, u, load(x, at + width * n, one))
            store(x, at + width * n, v)
            store(x, at + 2 * width * n, fused(-h, v, fused(-g, u, load(x, at + 2 * width * n, one))))
        for i in range(p + 3, m, 3):
            lessened(x, i, p, p + 3, width, p, width, one)
    for p in range(m - 3, -1, -3):
        at = (p * width + p) * n
        d0, d1 = 1.0 / load(x, at, one), 1.0 / load(x, at + (width + 1) * n, one)
        d2 = 1.0 / load(x, at + (2 * width + 2) * n, one)
        f, g, h = load(x, at + n, one), load(x, at + 2 * n, one), load(x, at + (width + 2) * n, one)
        for j in range(m, width):
            at = (p * width + j) * n
            w = d2 * load(x, at + 2 * width * n, one)
            v = d1 * fused(-h, w, load(x, at + width * n, one))
            store(x, at, d0 * fused(-f, v, fused(-g, w, load(x, at, one))))
            store(x, at + width * n, v)
            store(x, at + 2 * width * n, w)
        for i in range(0, p, 3):
            lessened(x, i, p, m, width, p, width, one)
