"""Elements in the workspace: place k of it holds the number k of each body, side by side."""

from ..geometry.compiled import inlined
from ..geometry.elements import lanes, load, store


@inlined
def vector(x, place, one):
    n = lanes(one)
    return (load(x, place * n, one), load(x, (place + 1) * n, one), load(x, (place + 2) * n, one))


@inlined
def put_vector(x, place, v):
    n = lanes(v[0])
    store(x, place * n, v[0])
    store(x, (place + 1) * n, v[1])
    store(x, (place + 2) * n, v[2])


@inlined
def matrix(x, place, one):
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def quaternion_at(x, place, one):
    n = lanes(one)
    w, (a, b, c) = load(x, place * n, one), vector(x, place + 1, one)
    return (w, a, b, c)


@inlined
def add_to(x, place, value):
    n = lanes(value)
    store(x, place * n, load(x, place * n, value) + value)
