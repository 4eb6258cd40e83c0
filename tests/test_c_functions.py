"""C functions as loads: the bits of the same function in Python compiled, in every way to run a body."""

import ctypes
import pickle
import re
import shutil
import subprocess

import numpy as np
import pytest
from scipy import LowLevelCallable

from conftest import BODIES, compiled_load
from nontwist import (
    body_moment,
    damping,
    integrate,
    moment,
    propagator,
    simulate,
    simulate_ensemble,
    stepper,
)
from nontwist.errors import SimulationError, Status
from refusals import refused_as

DOUBLES = ctypes.POINTER(ctypes.c_double)
CALLED = ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [DOUBLES])
SIGNATURE = "void (double t, const double *directors, const double *angular_velocity, double *moment)"
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


class OfNumba:
    """What `numba.cfunc` makes of a function, as far as a load looks at it."""

    native_name = "cfunc"

    def __init__(self, function):
        self.__name__, self._function = function.__name__, CALLED(function)

    @property
    def ctypes(self):
        return self._function


class OfComplexNumbers(OfNumba):
    @property
    def ctypes(self):
        raise TypeError("Cannot convert Numba type 'complex128' to ctypes type")


@OfNumba
def in_numba(t, d, w, m):
    m[0] = 2.0 * d[7] - 0.1 * w[0]
    m[1] = -2.0 * d[6] - 0.1 * w[1]
    m[2] = t - 0.1 * w[2]


@pytest.fixture(scope="module")
def from_c(tmp_path_factory):
    """A function of a library that a C compiler has made."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("library")
    (folder / "swing.c").write_text(SOURCE, encoding="utf-8")
    options = ["-O2", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([compiler, *options, "swing.c", "-o", "swing.so"], cwd=folder, check=True)
    function = ctypes.CDLL(str(folder / "swing.so")).swing
    function.restype, function.argtypes = None, [ctypes.c_double, DOUBLES, DOUBLES, DOUBLES]
    return function


MADE = {
    "ctypes": lambda function: function,
    "ctypes, by its address": lambda function: ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [DOUBLES])(
        ctypes.cast(function, ctypes.c_void_p).value
    ),
    "LowLevelCallable": LowLevelCallable,
    "LowLevelCallable, const": lambda function: LowLevelCallable(
        function, signature="void (double, const double *, const double *, double *)"
    ),
    "numba.cfunc": lambda function: in_numba,
    "ctypes, of Python": lambda function: ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [DOUBLES])(in_python),
}


def in_python(t, d, w, m):
    m[0], m[1], m[2] = swing(t, np.array(d[:9]).reshape(3, 3), w)


@pytest.fixture(params=MADE)
def load(request, from_c):
    return moment(MADE[request.param](from_c))


def test_it_is_the_same_motion_bit_for_bit(load):
    same = compiled_load(swing)
    assert load.is_compiled
    for integrator in ("lie-midpoint", "energy-momentum", "split", "continuous"):
        there, here = (integrate(BODIES["standard"](), integrator=integrator, load=one, **HOW) for one in (load, same))
        assert np.array_equal(there.quaternion, here.quaternion)
        assert np.array_equal(there.load_work, here.load_work)
    velocities = np.random.default_rng(5).normal(size=(11, 3))
    how = {**HOW, "angular_velocity": velocities, "load_scale": np.arange(11.0), "threads": 2, "variables": "all"}
    many = [simulate_ensemble(BODIES["standard"](), load=one, **how) for one in (load, same)]
    assert many[0].equals(many[1])
    run, same_run = (propagator(BODIES["standard"](), t_end=0.5, step=0.01, load=one) for one in (load, same))
    start = {"angular_velocity": (1, 2, 3), "load_scale": 3.0}
    assert np.array_equal(run(**start).quaternion, same_run(**start).quaternion)
    loops = [stepper(BODIES["standard"](), 0.01, load=one) for one in (load, same)]
    for loop in loops:
        loop.reset(angular_velocity=(1, 2, 3))
    assert [loops[0].step().quaternion for _ in range(9)] == [loops[1].step().quaternion for _ in range(9)]


def test_it_adds_up_with_others(load):
    same = compiled_load(swing)
    sums = [2 * one - 0.5 * same + damping(0.1) + 3 * one for one in (load, same)]
    there, here = (integrate(BODIES["nontwisting"](), project=True, load=one, **HOW) for one in sums)
    assert np.array_equal(there.quaternion, here.quaternion)


def test_python_evaluates_it(load):
    q, w = np.arange(9.0).reshape(3, 3), np.array([1.0, -2, 3])
    for directors in (q, q.T):
        assert np.array_equal(load.state_moment(0.5, directors, w), swing(0.5, directors, w))


def test_it_is_a_value(from_c):
    load = moment(from_c)
    assert load == moment(from_c)
    assert hash(load) == hash(moment(from_c))
    assert load not in (moment(in_numba), 2 * load, compiled_load(swing))
    assert repr(load) == "<Load: function C.swing>"
    run = simulate(BODIES["standard"](), load=load, **HOW)
    assert run.attrs["load"] == '[{"kind": "state", "scale": 1.0, "function": "C.swing"}]'


def test_it_cannot_be_pickled(from_c):
    with pytest.raises(pickle.PicklingError, match="load the library and call"):
        pickle.dumps(damping(1) + moment(from_c))


@OfNumba
def late(t, d, w, m):
    m[0] = m[1] = m[2] = np.sqrt(0.25 - t) if t <= 0.25 else np.nan


def test_a_number_that_is_not_finite_ends_the_run():
    message = "step 25 at t = 0.25 s: the load late is not finite at t = 0.25"
    with pytest.raises(SimulationError, match=f"^{re.escape(message)}") as info:
        integrate(BODIES["standard"](), load=moment(late), **HOW)
    assert info.value.status == Status.LOAD
    assert len(info.value.partial.time) == 26


@OfComplexNumbers
def of_complex(t, d, w, m):
    pass


test_refused_with_the_right_signature = refused_as(
    {
        "not declared": lambda: moment(ctypes.CDLL(None).abs),
        "of one number": lambda: moment(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(abs)),
        "complex": lambda: moment(of_complex),
        "user data": lambda: moment(LowLevelCallable(in_numba.ctypes, ctypes.c_void_p(1))),
        "null": lambda: moment(ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [DOUBLES])(0)),
        "of time": lambda: body_moment(in_numba),
    }
)
