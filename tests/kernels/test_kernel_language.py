"""The little language of kernels: operators, lanes, duals, series, memory, control flow, refusals, threads, forks."""

import math
import os
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mpmath
import numpy as np
import pytest

from nontwist.kernels import elements, machine_code
from nontwist.kernels.control import Variables, loop, when
from nontwist.kernels.dual import Dual, jacobian, plain, seeded, tangent
from nontwist.kernels.elements import arctan2, cos, exp, fma, larger, logical_not, select, sin, smaller, sqrt, without
from nontwist.kernels.kernel import Kernel, kernel, part
from nontwist.kernels.memory import put, vector_at
from nontwist.kernels.series import Recurrence
from nontwist.kernels.vectors import Vector
from texts_rule import faults

HERE = Path(__file__).parents[1]
ROOT = HERE.parent / "src/nontwist"
rng = np.random.default_rng(1)
ORDERS = (1, 0, 0), (0, 1, 0), (0, 0, 1)
X, Y = rng.normal(size=(2, 40)) * 10.0 ** rng.integers(-3, 4, size=(2, 40))


def in_lanes(f, n):
    """Return the kernel of a function of two numbers, n lanes at a time."""

    def text(x, y, out):
        for i in loop(0, x.shape[0], n):
            a, b = x.load(i, n), y.load(i, n)
            out.store(i, f(a, b), n)

    return Kernel(text, "f8[:], f8[:], f8[:]", lanes=n)


OPERATORS = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: 2.0 - (x - y) - 1,
    "*": lambda x, y: 3 * x * y * np.float64(2.0),
    "/": lambda x, y: 1.0 / (x / y) / 7,
    "neg": lambda x, y: -x,
    "abs": lambda x, y: abs(x),
    "power": lambda x, y: elements.power(x, 3) + elements.power(y, -2) + elements.power(abs(x), 0.5),
    "select": lambda x, y: select(x < y, x, 2.0),
    "masks": lambda x, y: select(((x <= y) | (x > 1.0)) & (y != 0.5), 1.0, y),
    "without": lambda x, y: select(without(x >= y, logical_not(y == y)), x, y),
    "larger": lambda x, y: larger(x, smaller(y, 0.25)),
    "sqrt": lambda x, y: sqrt(abs(x)),
    "sin": lambda x, y: sin(x),
    "cos": lambda x, y: cos(x) + exp(smaller(y, 1.0)),
    "arctan2": lambda x, y: arctan2(x, y),
    "others": lambda x, y: elements.tan(x) + elements.log(abs(y)) + elements.arcsin(smaller(abs(x), 1.0)),
    "fma": lambda x, y: fma(x, y, -(x * y)),
    "floor": lambda x, y: elements.floor(x) + elements.tanh(y),
}


@pytest.mark.parametrize("name", OPERATORS)
def test_operators(name):
    f = OPERATORS[name]
    with np.errstate(all="ignore"):
        floats = np.array([f(x, y) for x, y in zip(X, Y, strict=True)])
        assert np.isfinite(floats).all()
    for n in (1, 2, 4, 8):
        out = np.empty(40)
        in_lanes(f, n)(X, Y, out)
        assert (out == floats).all(), n
    if name != "fma":  # of arrays twice rounded
        np.testing.assert_allclose(f(X, Y), floats, rtol=4e-16 if name in "+-*/" else 1e-14)


def test_numbers_of_other_kinds():
    x = mpmath.mpf("0.3")
    assert mpmath.almosteq(sin(x) ** 2 + cos(x) ** 2, 1, 1e-15)
    assert sqrt(np.longdouble(2.0)).dtype == np.longdouble
    assert sqrt(-1.0 + 0.0j) == 1j
    assert abs(exp(1e-20j).imag - 1e-20) < 1e-35
    assert math.isnan(sqrt(-1.0))
    assert elements.power(2.0, -3) == 0.125
    assert (exp(1000.0), elements.log(0.0)) == (math.inf, -math.inf)
    assert fma(0.1, 10.0, -1.0) == (2.0**-54 if machine_code.is_fused() else 0.0)


def test_without_a_fused_multiply_add(monkeypatch):
    name, features = machine_code.processor()
    monkeypatch.setattr(machine_code, "processor", lambda: (name, features.replace("+fma", "-fma") + ",-fma"))
    out = np.empty(40)
    in_lanes(lambda x, y: fma(x, y, 1.0), 1)(X, Y, out)
    assert (out == X * Y + 1.0).all()


def smooth(x):
    """Return functions of three numbers that take every rule of differentiation."""
    a, b, c = x
    r = sqrt(a * a + b * b + 2.0)
    first = sin(a) * cos(b) / r - exp(0.1 * c) * (3.0 - a) / 2.0 + fma(a, b, c * c)
    second = elements.tanh(a) + elements.arctan(b) - elements.log(c * c + 1.0) + elements.sinh(a) * elements.cosh(b)
    third = arctan2(b + 3.0, r) + elements.tan(0.1 * c) + elements.arcsin(0.1 * a) - elements.arccos(0.1 * b) + 1.0 / r
    return Vector(first, second, third + select(a < b, a * b, b - c) + c**3)


def test_duals_by_many_digits():
    def text(x, out):
        put(out, tuple(jacobian(smooth, vector_at(x))))

    k, x = Kernel(text, "f8[:], f8[:]"), rng.normal(size=3)
    by_machine, by_floats = np.empty((2, 9))
    k(x, by_machine)
    k.on_floats(x, by_floats)
    assert (by_machine == by_floats).all()
    with mpmath.workdps(30):
        at = tuple(map(mpmath.mpf, x))
        slopes = [[mpmath.diff(lambda *y: smooth(y)[i], at, n) for i in range(3)] for n in ORDERS]  # noqa: B023
    np.testing.assert_allclose(by_machine, np.array(slopes, float).ravel(), rtol=1e-13)


def test_duals_without_derivative():
    x = seeded(Vector(0.0, 0.0, 0.0))
    r = sqrt(x @ x)
    assert (plain(r), *(tangent(r, j) for j in range(3))) == (0.0, 0.0, 0.0, 0.0)
    for x in (-3.0, 2.0):
        found = abs(Dual(x, [1.0, -2.0]))
        assert (found.value, found.tangents) == (abs(x), [np.sign(x), -2.0 * np.sign(x)])


def test_a_kernel_of_arrays():
    @kernel("f8[:, :], i8, f8[:] -> f8, i8")
    def column(a, j, out):
        for i in loop(a.shape[0]):
            out[i] = a[i][j] * a[i, 0]
        return a[a.shape[0] - 1, j], j + a.shape[1]

    a, out = rng.normal(size=(5, 4)), np.empty(5)
    for call in (lambda: column(a.T.copy().T, 2, out), column.bound(a, 2, out), lambda: column.on_floats(a, 2, out)):
        out[...] = 0.0
        assert call() == (a[-1, 2], 6)  # the first is not contiguous: a copy
        assert (out == a[:, 2] * a[:, 0]).all()
    with pytest.raises(ValueError, match="is not what a kernel takes"):
        kernel("f8[:,:]")(leaking)
    with pytest.raises(TypeError, match="an array of f8 with 2 axes"):
        column(a[0], 2, out)
    with pytest.raises(TypeError, match="not contiguous"):
        column.bound(a.T, 2, out)


def leaking(x):
    y = 0.0
    for _ in when(x[0] > 0.0):
        y = x[0] + 1.0
    return y


def left(x):
    for i in loop(3):
        if i is not None:
            break
    return x[0]


def masks(x):
    for _ in when(x.load(0, 4) > 0.0):
        pass
    return 1.0


@part
def again(x):
    return again(x)


def test_part_per_constant():
    combined = part(lambda x, how: x * x if how == "square" else x + x)

    @kernel("f8 -> f8, f8, f8")
    def all_three(x):
        return combined(x, "square"), combined(x, "double"), combined(x, "square")

    assert all_three(3.0) == (9.0, 6.0, 9.0)


REFUSED = {
    "select(condition, a, b)": lambda x: 1.0 if x[0] > 0.0 else 2.0,
    "keep it in Variables": leaking,
    "break or return left the loop": left,
    "no value yet": lambda x: float(x[0]),
    "any_of(mask)": masks,
    "lanes meet": lambda x: x.load(0, 4) + x.load(0, 2),
    "calls itself": lambda x: again(x[0]),
    "a.shape[0]": lambda x: len(x),
    "there is no variable b": lambda x: Variables(a=1.0).b,
    "cannot be a variable": lambda x: Variables(a="1"),
    "was None first": lambda x: setattr(Variables(a=None), "a", 1.0),
    "not a whole number": lambda x: loop_once(x[0]),
    "is not a mask": lambda x: (x[0] > 0.0) & x[0],
}


@pytest.mark.parametrize("what", REFUSED)
def test_refusals_say_what_to_write(what):
    with pytest.raises((TypeError, AttributeError)) as found:
        Kernel(REFUSED[what], "f8[:] -> f8").code()
    assert what in str(found.value)
    if REFUSED[what] is leaking:  # and where
        assert f"within the branch at {__file__}:{leaking.__code__.co_firstlineno + 2}" in str(found.value)


def loop_once(n):
    for _ in loop(n):
        pass


def test_threads_trace_at_once():
    kernels = [in_lanes(lambda x, y, c=float(c): x * c + y, 4) for c in range(6)]

    def work(first):
        found = np.empty((6, 40))
        for c in np.roll(range(6), first):
            kernels[c](X, Y, found[c])
        return (found == np.outer(np.arange(6.0), X) + Y).all()

    with ThreadPoolExecutor(6) as pool:
        assert all(pool.map(work, range(6)))


CHILDREN = """
    import threading, os, signal, sys, time, warnings
    import numpy as np
    from nontwist import moment
    from nontwist.kernels.kernel import Kernel
    warnings.simplefilter("ignore", DeprecationWarning)
    def kernel(c):
        return Kernel(lambda x: x * (c + 0.5), "f8 -> f8")
    def load(c):
        moment(lambda t, d, w: (c * w[0], 0.0, 0.0), compiled=True)
        return lambda x: x * (c + 0.5)
    new = globals()[sys.argv[1]]
    done = threading.Event()
    traced = []
    def trace():
        c = 0
        while not done.is_set():
            traced.append(new(c)(1.0))
            c += 1
    old = new(1000)
    old(1.0)
    threads = [threading.Thread(target=trace) for _ in range(2)]
    for t in threads: t.start()
    failed = 0
    for c in range(8):
        count = len(traced)
        while len(traced) == count: time.sleep(0)  # then a thread is amid the next kernel
        child = os.fork()
        if not child:
            signal.alarm(300)  # ends a child that waits for a lock that nobody holds
            ok = new(c)(2.0) == 2 * c + 1.0 and old(2.0) == 2001.0
            os._exit(0 if ok else 1)
        failed += os.waitpid(child, 0)[1] != 0
    done.set()
    for t in threads: t.join()
    print("failed", failed)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize("new", ["kernel", "load"])
def test_forked_children_trace_for_themselves(new):
    found = subprocess.run([sys.executable, "-c", textwrap.dedent(CHILDREN), new], capture_output=True, text=True)
    assert found.stdout == "failed 0\n", found.stderr


def test_kernels_release_the_lock():
    @kernel("i8 -> f8")
    def long(n):
        v = Variables(x=1.0)
        for _ in loop(n):
            v.x = sin(v.x)
        return v.x

    inside, seen = [], []

    def work():
        for _ in range(1000):
            inside.append(True)
            long(1_000_000)
            inside.clear()
            if seen:
                break

    long(1)
    interval, thread = sys.getswitchinterval(), threading.Thread(target=work)
    sys.setswitchinterval(1e6)  # without forced switches, only the kernel itself lets the other thread run
    try:
        thread.start()
        while thread.is_alive() and not seen:
            seen += inside
            time.sleep(0)
        thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert seen


def test_variables_of_texts():
    texts = {path: path.read_text(encoding="utf-8") for path in ROOT.rglob("*.py")}
    texts = {path: text for path, text in texts.items() if "loop(" in text or "when(" in text or "whilst(" in text}
    assert len(texts) > 10
    assert {path: found for path, text in texts.items() if (found := faults(text))} == {}


WRONG = """
def one(x):
    total = 0.0
    for i in loop(3):
        total = total + x[i]
def two(x):
    total = 0.0
    for i in loop(3):
        total += x[i]
def three(x):
    for _ in when(x[0] > 0.0):
        y = 1.0
    return y
def right(x):
    v = Variables(y=0.0)
    for i in loop(3):
        y = x[i]
        v.y = v.y + y
    y = v.y
    return y
"""


def test_rule_finds_faults():
    assert [line for line, _ in faults(WRONG)] == [5, 9, 12]


ORDER = 12


def exponential(out):
    """Write the coefficients of the solution of ``x' = k (x - x²)``, x(0) = 2, k = 3, and what x(0) and k change."""
    recurrence = Recurrence(ORDER, 2)
    x, k = recurrence.unknown(), Dual(3.0, [0.0, 1.0])
    x.set_coefficient(0, Dual(out[0], [1.0, 0.0]))
    recurrence.solve([x], [k * (x - x * x)])
    for n, found in enumerate([*(x[n] for n in range(ORDER + 1)), x.at(0.01)]):
        for j, number in enumerate((found.value, *found.tangents)):
            out[3 * n + j] = number


def test_series_of_a_closed_form():
    """``x = 1 / (1 - a e^(-kt))`` with a = 1 - 1/x(0); on floats as on the machine."""
    out, by_floats = np.full((2, 3 * (ORDER + 2)), 2.0)
    kernel("f8[:]")(exponential)(out)
    exponential(by_floats)
    np.testing.assert_array_equal(out, by_floats)
    with mpmath.workdps(40):

        def x(t):
            return 1 / (1 - mpmath.exp(-3 * t) / 2)

        def by_start(t):
            return mpmath.exp(-3 * t) * x(t) ** 2 / 4

        def by_factor(t):
            return -t * mpmath.exp(-3 * t) * x(t) ** 2 / 2

        for column, true in zip(out.reshape(-1, 3).T, (x, by_start, by_factor), strict=True):
            np.testing.assert_allclose(column[:-1], np.array(mpmath.taylor(true, 0, ORDER), dtype=float), rtol=1e-13)
            assert abs(column[-1] - float(true(mpmath.mpf("0.01")))) < 1e-15
