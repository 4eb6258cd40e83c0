"""Functions of the state that are compiled, and C functions: they give what Python gives, or are refused.

C functions have the bits of the same function in Python compiled, in every way to run a body.
"""

import contextlib
import ctypes
import functools
import itertools
import math
import pickle
import random
import resource
import shutil
import subprocess
import sys
from math import sin
from random import uniform
from time import perf_counter

import mpmath
import numpy as np
import pytest
from scipy import LowLevelCallable, special

from conftest import BODIES, compiled_load
from nontwist import body_moment, damping, director_forces, integrate, moment, potential, simulate
from nontwist.loads.functions import Moment
from refusals import refused_as

DOUBLES = ctypes.POINTER(ctypes.c_double)
TABLE = np.array([[0.0, 1.0, 3.0], [2.0, -1.0, 4.0]])
WEIGHTS = [0.3, 0.7]
NESTED = {"a": [1.0]}
COUNT = itertools.count()
memory = {"calls": 0}
calls = 0
rng = np.random.default_rng(7)
STATES = [(0.0, np.eye(3), np.zeros(3))]
STATES += [(t, rng.normal(size=(3, 3)), rng.normal(size=3)) for t in (-0.7, 0.4, 1.0, 2.5, 9.0)]


def machine(part, t, d, w, count=3):
    """Call a C function."""
    d, w, found = np.ascontiguousarray(d), np.ascontiguousarray(w), np.full(count, np.nan)
    Moment(part.address)(t, *(a.ctypes.data_as(DOUBLES) for a in (d, w, found)))
    return found


def arrays(t, d, w):
    B = np.array([0.0, 1e-5 * np.sin(0.3 * t), 2e-5])
    return np.cross(-4e4 * np.cross(w, B), B) + np.cross(d[2], [0, 0, -9.81]) * (1 + 0.1 * np.cos(t))


def assigned(t, d, w):
    m = np.zeros(3)
    for i in range(3):
        m[i] += d[i] @ w
    m[1:] *= 2
    m -= np.dot(d, w) / 3
    return m


def mutated(t, d, w):
    w[0], d[1] = 5.0, w
    d *= 2
    return d[1] + w


def mathematics(t, d, w):
    s = sin(t) + math.exp(-(t**2)) + math.hypot(*w) + math.atan2(w[0], w[1]) + math.pow(abs(t), 0.3) + math.radians(t)
    return s, math.floor(t) + math.ceil(w[0]) + math.copysign(2.0, w[1]), math.sqrt(max(w[0], 0.0)) + min(t, 1.0, w[2])


def switched(t, d, w):
    inside = (t > 0.3) & (t < 2.0)
    x = np.where(inside, w, -d[0]) + np.where(w > 0, 1.0, [1, 2, 3])
    return np.clip(x, -1, 1) + np.maximum(w, 0.1) * (t > 1) + np.sign(w) * np.logical_or(t > 2, w[0] > 0)


def reductions(t, d, w):
    n = np.linalg.norm(w)
    q = w / n if isinstance(t, np.ndarray) else w / np.maximum(n, 1e-9)
    return np.sum(d, axis=0) + d.max() - w.min() + w.mean() + np.trace(d) * q + np.linalg.norm(d, axis=1)


def periodic(t, d, w):
    powers = 2.0**t + np.float_power(abs(w[2]), t)
    return t % 0.7 + t // 0.3 + 2 // (t + 10), np.mod(w[0], -1.5), np.fmod(w[1], 0.4) + powers


def tables(t, d, w):
    return np.interp(t, [0.0, 1.0, 2.5], [3.0, -1.0, 4.0]), np.interp(w[0], [0.0, 0.5], [1.0, 2.0], left=-9), 0.0


def outside(t, d, w):
    t = t + TABLE[0, 1] + np.where(TABLE[0, 1] > t, TABLE[0, 2], t)
    return TABLE[1] * w + TABLE.T[:, 0] * WEIGHTS[1] * t + memory["calls"] + sum(WEIGHTS)


def products(t, d, w):
    return np.einsum("ij,j->i", d, w) + np.outer(w, w) @ d[0] + (d.T @ w).copy() + np.stack([w, w])[1] + w.sum()


def helper(x, /, power=2, *, factor=1.0):
    import math as m

    return factor * x**power * m.cos(0.1)


def deep(t, d, w, depth=3):
    return w if depth == 0 else np.cross(d[0], deep(t, d, w, depth - 1))


class Coil:
    def __init__(self, factor):
        self.factor = factor

    def moment(self, t, d, w):
        return self.factor * np.maximum(w, t) + self.wave(t) * len(self)

    def wave(self, t):
        return math.sin(t)

    def __len__(self):
        return 2 if isinstance(self, Coil) and type(self) is Coil else 3

    def __call__(self, t, d, w):
        return self.moment(t, d, w) * 2


def chosen(t, d, w):
    is_long = (w > -0.5) * (w < 1.0)
    m = np.divide(1.0, w, out=np.zeros(3), where=np.abs(w) > 0.3)
    return m + is_long * np.any(w > 0) + np.sum(w > 0) * np.all(is_long) + max(0.0, np.sqrt(w[0]))


def doubles(t, d, w):
    x = np.array([t, w[0], 1], dtype=w.dtype) + np.zeros(3, float) + np.var(w) + np.sum(w, dtype=float)
    is_known = w.dtype.kind == "f" and type(t) is float and np.isscalar(t)
    return x + math.log(2 + t * t, 3 + w[1] ** 2) if is_known else -x


def functions(t, d, w, name="cosine", known=(math.tanh, math.atan)):
    return known[0](t), KNOWN[name](w[0]), KNOWN["list"][0](np.sin(w[1]))


KNOWN = {"cosine": math.cos, "list": [lambda x: x * math.sinh(0.1 * x)]}


FINE = (arrays, assigned, mutated, mathematics, switched, reductions, periodic, tables, outside, products, chosen)
FINE += (doubles, functions)
FINE = {f.__name__: f for f in FINE} | {
    "helpers": lambda t, d, w: (helper(w[0]), helper(w[1], 3, factor=2.0), helper(abs(w[2]), power=1.5) + helper(t, 0)),
    "whole numbers": lambda t, d, w: (True, 2, 3 * t),
    "masks": lambda t, d, w: (t > 1, np.isfinite(t), float(w[0] > 0) + np.isnan(w[1])),
    "a method": Coil(2.0).moment,
    "an instance": Coil(3.0),
    "partial": functools.partial(deep, depth=2),
    "keywords": lambda t, d, w: np.clip(w, a_min=-0.1, a_max=np.clip(t, a_min=0.2, a_max=0.9)),
    "a column": lambda t, d, w: tuple(x for x in w),
}


@pytest.mark.parametrize("name", FINE)
@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning", "ignore:invalid value:RuntimeWarning")
def test_compiled_equals_python(name):
    """By dual numbers; central differences wherever those to both sides agree, which at kinks they do not."""
    function, term, compared = FINE[name], moment(FINE[name], compiled=True).terms[0], 0
    _spoilt = [term.c_function, *(np.full((n, 3), np.nan) for n in range(2, 50) for _ in range(9))]  # what was freed

    def value(x):
        return np.array(function(float(x[12]), x[:9].reshape(3, 3).copy(), x[9:12].copy()), dtype=float)

    for t, d, w in STATES:
        flat = np.concatenate([d.ravel(), w, [t]])
        np.testing.assert_allclose(machine(term.c_function, t, d, w), value(flat), rtol=4e-15, atol=1e-15)
        if not w.any():
            continue
        rows = machine(term.slopes, t, d, w, count=(3, 14))
        np.testing.assert_allclose(rows[:, 0], value(flat), rtol=4e-15, atol=1e-15)
        for j in range(13):
            e = np.eye(13)[j]
            here, ahead, behind = value(flat), value(flat + 1e-5 * e), value(flat - 1e-5 * e)
            near, apart = (ahead - behind) / 2e-5, (ahead - 2 * here + behind) / 1e-5
            smooth = abs(apart) <= 1e-3 * (1 + abs(near))
            np.testing.assert_allclose(rows[smooth, 1 + j], near[smooth], rtol=1e-6, atol=1e-6)
            compared += smooth.sum()
    assert compared >= 0.8 * 5 * 3 * 13


FUNCTIONS = "arcsinh arctanh cbrt expm1 log10 log1p sqrt exp log sin cos tan sinh cosh tanh arcsin arccos arctan"
OTHERS = {  # how mpmath has them
    "exp2": lambda y: 2**y,
    "log2": lambda y: mpmath.log(y, 2),
    "absolute": abs,
    "square": lambda y: y * y,
    "degrees": mpmath.degrees,
    "reciprocal": lambda y: 1 / y,
}


def test_numpy_functions_have_derivatives():
    def function(t, d, w):
        x = d[0, 0]
        return sum(getattr(np, name)(x) for name in [*FUNCTIONS.split(), *OTHERS]) + np.arccosh(1 + x), t ** w[2], 0.0

    term = moment(function, compiled=True).terms[0]
    rows = machine(term.slopes, 0.37, np.full((3, 3), 0.6), np.array([0.3, 0.7, 1.1]), count=(3, 14))
    x, z, t = map(mpmath.mpf, ("0.6", "1.1", "0.37"))
    functions = [getattr(mpmath, name.replace("arc", "a")) for name in FUNCTIONS.split()]
    expected = sum(mpmath.diff(f, x) for f in [*functions, *OTHERS.values(), lambda y: mpmath.acosh(1 + y)])
    found = [rows[0, 1], rows[1, 12], rows[1, 13]]
    assert found == pytest.approx([float(y) for y in (expected, mpmath.log(t) * t**z, z * t ** (z - 1))], rel=1e-13)


def endless(t, d, w):
    return endless(t, d, w)


def counting(t, d, w):
    global calls
    calls += 1
    return w


def long(t, d, w):
    for _ in range(10**6):
        w = w + 0.1 * np.sin(w)
    return w


def remembering(t, d, w, known=[]):  # noqa: B006
    known.append(t)
    return w * len(known)


def within(t, d, w):
    def inner():
        global calls
        calls = calls + 1

    inner()
    return w


def careful(t, d, w):
    try:
        return math.sqrt(t) * w
    except ValueError:
        return 0 * w


def careless(t, d, w):
    with contextlib.suppress(Exception):
        if t > 1:
            w = -w
    return w


def single(t, d, w):
    m = np.zeros(3, np.float32)
    m[0] = t
    return m


class Recorder:
    def __init__(self):
        self.history, self.integral = [], np.zeros(3)

    def record(self, t, d, w):
        self.history.append(t)
        return w

    def integrate(self, t, d, w):
        self.integral[0] += 1.0
        return w + self.integral


class Counter:
    calls = 0

    def __call__(self, t, d, w):
        self.calls += 1
        return w


def nonlocal_count():
    count = 0

    def inner(t, d, w):
        nonlocal count
        count += 1
        return w

    return inner


BRANCH = "it branches (if, while, and, or, not) on the time or the state: use np.where(condition, a, b)"
KEPT = "is changed, but what is compiled keeps nothing between calls: use compiled=False"
REFUSED = {  # the function, the line after its first, what is said
    "a choice": (lambda t, d, w: w if t < 1 else -w, 0, BRANCH),
    "endless recursion": (endless, 1, "it calls itself without end: use compiled=False"),
    "two numbers": (lambda t, d, w: w[:2], 0, "it returns 2 values; return three numbers"),
    "a matrix": (lambda t, d, w: d, 0, "it returns the shape (3, 3); return three numbers"),
    "nothing": (lambda t, d, w: None, 0, "it returns NoneType; return three numbers"),
    "complex": (lambda t, d, w: (1j, 0, 0), 0, "it returns 1j; return numbers"),
    "print": (lambda t, d, w: (print(t), 0, w[0]), 0, "print() happens when Python calls a function"),
    "SciPy": (lambda t, d, w: special.jv(0, w), 0, "functions of NumPy and math can be compiled, others need"),
    "a global number": (counting, 2, f"calls {KEPT}"),
    "a nonlocal number": (nonlocal_count(), 2, f"count {KEPT}"),
    "an attribute": (Counter(), 1, f"calls {KEPT}"),
    "a dictionary": (lambda t, d, w: memory.update(calls=t) or w, 0, "a dict outside the function is changed: use"),
    "a list": (lambda t, d, w: WEIGHTS.append(t) or w, 0, "a list outside the function is changed: use"),
    "random numbers": (lambda t, d, w: w * random.random(), 0, "random.random gives something else at each call"),
    "an index": (lambda t, d, w: TABLE[0][int(t)] * w, 0, "it needs the time or the state as a plain number"),
    "random numbers by name": (lambda t, d, w: w * uniform(0, 1), 0, "random.uniform gives something else at each"),
    "a generator": (lambda t, d, w: w * rng.normal(), 0, "Generator.normal gives something else at each call"),
    "the time of day": (lambda t, d, w: w * perf_counter(), 0, "time.perf_counter gives something else at each call"),
    "an iterator": (lambda t, d, w: w * next(COUNT), 0, "itertools.count gives something else at each call"),
    "print, by another name": (lambda t, d, w, show=print: (show(t), 0, w[0]), 0, "print() happens when Python calls"),
    "a list in a dictionary": (lambda t, d, w: NESTED["a"].append(t) or w, 0, "a list outside the function is changed"),
    "a default": (remembering, 1, "a list outside the function is changed"),
    "a list of an object": (Recorder().record, 1, "a list outside the function is changed"),
    "an array of an object": (Recorder().integrate, 1, "assignment destination is read-only"),
    "a global number, within": (within, 3, f"calls {KEPT}"),
    "an exception": (careful, 3, "it catches exceptions, which what is compiled does not raise"),
    "an exception of ours": (careless, 2, BRANCH),
    "text": (lambda t, d, w: w * len(str(t)), 0, "it needs the time or the state as a plain number"),
    "integers": (lambda t, d, w: np.array(w, dtype=int), 0, "traced numbers cannot become int64"),
    "integers, by position": (lambda t, d, w: np.full(3, t, int), 0, "traced numbers cannot become int64"),
    "single precision": (lambda t, d, w: w.astype(np.float32), 0, "traced numbers cannot become float32"),
    "a sum of integers": (lambda t, d, w: np.sum(w, dtype=int) * w, 0, "traced numbers cannot become int64"),
    "an array of single precision": (single, 2, "it needs the time or the state as a plain number"),
    "a sum of conditions": (lambda t, d, w: ((w > 0) + (w > 1)) * w, 0, "the sum of two conditions is one in NumPy"),
    "a falling table": (lambda t, d, w: np.interp(t, [1, 0], [0, 1]) * w, 0, "places of np.interp must not decrease"),
    "long loops": (long, 2, "its loops are written out, which takes more than 30000 operations"),
    "an unknown name": (lambda t, d, w: nowhere * w, 0, "NameError: name 'nowhere' is not defined"),  # noqa: F821
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_the_line(name):
    function, line, words_of_it = REFUSED[name]
    code = getattr(function, "__code__", None) or type(function).__call__.__code__
    before = (list(WEIGHTS), dict(memory), calls, repr(NESTED))
    with pytest.raises(ValueError, match="cannot be compiled: ") as info:
        moment(function, compiled=True)
    assert words_of_it in str(info.value)
    assert f"({__file__}, line {code.co_firstlineno + line})" in str(info.value)
    assert info.value.__cause__ is not None
    assert before == (WEIGHTS, memory, calls, repr(NESTED))


def test_compiled_once():
    factor, weights = 2.0, np.array([1.0, 2.0, 3.0])

    def held(t, d, w):
        return factor * weights * w

    loads = [moment(held, compiled=True) for _ in range(3)]
    assert len({load.terms[0].c_function.address for load in loads}) == 1
    factor, weights[:] = 5.0, 0.0
    assert machine(loads[0].terms[0].c_function, 0.0, np.eye(3), np.ones(3)).tolist() == [2.0, 4.0, 6.0]


def test_forces_and_gradients_are_refused():
    with pytest.raises(ValueError, match="it returns 3 values; return three rows of three numbers"):
        director_forces(lambda t, d, w: w, compiled=True)
    with pytest.raises(ValueError, match="the load <lambda> cannot be compiled: it branches"):
        potential((0, 0, 1), lambda g: g @ g, lambda g: 2 * g if g.sum() > 0 else g + g, compiled=True)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no resource module")
def test_memory_of_many_loads():
    def grown_by(count):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        load = [moment(lambda t, d, w, a=a: a * np.cos(a * t) * w, compiled=True) for a in map(float, range(1, count))]
        assert len({one.terms[0].c_function.address for one in load}) == count - 1
        return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * (1024 if sys.platform == "linux" else 1)

    grown_by(2)
    assert grown_by(51) < 50 * 0.1e6  # bytes: 2,000 of them take 200 MB


CALLED = ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [DOUBLES])
SOURCE = """
void swing(double t, const double *d, const double *w, double *m)
{
    m[0] = 2.0 * d[7] - 0.1 * w[0];
    m[1] = -2.0 * d[6] - 0.1 * w[1];
    m[2] = t - 0.1 * w[2];
}
"""
HOW = {"t_end": 0.5, "step": 0.01, "angular_velocity": (1, 2, 3)}


def swing(t, d, w):
    return 2.0 * d[2, 1] - 0.1 * w[0], -2.0 * d[2, 0] - 0.1 * w[1], t - 0.1 * w[2]


def in_python(t, d, w, m):
    m[0], m[1], m[2] = swing(t, np.array(d[:9]).reshape(3, 3), w)


class OfNumba:
    """What `numba.cfunc` makes of a function, as far as a load looks at it."""

    native_name, __name__, ctypes = "cfunc", "in_python", CALLED(in_python)


class OfComplexNumbers(OfNumba):
    @property
    def ctypes(self):
        raise TypeError("Cannot convert Numba type 'complex128' to ctypes type")


@pytest.fixture(scope="module")
def from_c(tmp_path_factory):
    """A function of a library that a C compiler has made."""
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("library")
    (folder / "swing.c").write_text(SOURCE, encoding="utf-8")
    command = "cc -O2 -ffp-contract=off -shared -fPIC swing.c -o swing.so"
    subprocess.run(command.split(), cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "swing.so")).swing
    function.restype, function.argtypes = None, [ctypes.c_double, DOUBLES, DOUBLES, DOUBLES]
    return function


CONST = "void (double, const double *, const double *, double *)"
MADE = {
    "ctypes": lambda function: function,
    "ctypes, by its address": lambda function: CALLED(ctypes.cast(function, ctypes.c_void_p).value),
    "LowLevelCallable": LowLevelCallable,
    "LowLevelCallable, const": lambda function: LowLevelCallable(function, signature=CONST),
    "numba.cfunc": lambda function: OfNumba(),
    "ctypes, of Python": lambda function: CALLED(in_python),
}


@pytest.mark.parametrize("name", MADE)
def test_c_functions_are_exact(name, from_c):
    """Alone, in a sum, and called by Python; in other ways to run a body: `test_contract`."""
    load, same, body = moment(MADE[name](from_c)), compiled_load(swing), BODIES["standard"]()
    assert load.is_compiled
    sums = [2 * one - 0.5 * same + damping(0.1) for one in (load, same)]
    every = ("lie-midpoint", "energy-momentum", "split", "continuous", "gauss")
    for integrator in every if name == "ctypes" else every[-1:]:
        for pair in ((load, same), sums) if integrator == "gauss" else (sums,):
            runs = [integrate(body, load=one, integrator=integrator, **HOW) for one in pair]
            assert np.array_equal(runs[0].quaternion, runs[1].quaternion)
            assert np.array_equal(runs[0].load_work, runs[1].load_work)
    q, w = np.arange(9.0).reshape(3, 3), np.array([1.0, -2, 3])
    for directors in (q, q.T):
        assert np.array_equal(load.state_moment(0.5, directors, w), swing(0.5, directors, w))


def test_c_function_cannot_be_pickled(from_c):
    load = moment(from_c)
    assert load == moment(from_c)
    assert hash(load) == hash(moment(from_c))
    assert load not in (moment(OfNumba()), 2 * load, compiled_load(swing))
    assert repr(load) == "<Load: function C.swing>"
    run = simulate(BODIES["standard"](), load=load, **HOW)
    assert run.attrs["load"] == '[{"kind": "state", "scale": 1.0, "function": "C.swing"}]'
    with pytest.raises(pickle.PicklingError, match="load the library and call"):
        pickle.dumps(damping(1) + load)


test_refused_with_the_right_signature = refused_as(
    {
        "not declared": lambda: moment(ctypes.CDLL(None).abs),
        "of one number": lambda: moment(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(abs)),
        "complex": lambda: moment(OfComplexNumbers()),
        "user data": lambda: moment(LowLevelCallable(OfNumba.ctypes, ctypes.c_void_p(1))),
        "null": lambda: moment(CALLED(0)),
        "of time": lambda: body_moment(OfNumba()),
    }
)
