"""Ensembles on a GPU: everything up to the calls of the driver, for which a processor stands in.

The stand-in takes the code that would be assembled, with the numbers of threads as arguments, compiles it for the
processor, and runs one thread after the other. What it is given lies in memory of its own, which is NaN before and
after. So results show that the code, the addresses and the arrays are right; PTX is made, and assembled where `ptxas`
is found, but no GPU has run it.
"""

import ctypes
import math
import re
import shutil
import subprocess
from itertools import product

import mpmath
import numpy as np
import pytest

import nontwist as nt
from conftest import or_long, thinned
from covering.problems import BODIES, FORCES, LOADS, TIMES, of_state, schemes
from integrators.test_contract import fading, remembered
from nontwist.errors import InputError
from nontwist.integrators import stack_march
from nontwist.kernels import elementary, gpu, machine_code
from nontwist.kernels.elements import LITERALS
from nontwist.kernels.kernel import Kernel, kernel
from nontwist.kernels.machine_code import lanes_of_text
from refusals import refused, says

PTXAS = shutil.which("ptxas")
INDICES = "ctaid", "ntid", "tid"
THREAD = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, *(ctypes.c_int32,) * 3)
ptx_of = gpu.ptx_of
W = np.random.default_rng(3).normal(size=(11, 3))
SCHEMES = schemes()
pytestmark = pytest.mark.filterwarnings("ignore:.* (off the grid|have failed):UserWarning")


def thread_of(code):
    """The code of a launch as a C function, which is given the numbers of its thread."""
    for name in INDICES:
        special = f"@llvm.nvvm.read.ptx.sreg.{name}.x()"
        code = code.replace(f"declare i32 {special}", "").replace(f"call i32 {special}", f"add i32 %{name}, 0")
    arguments = ", ".join(["i64 %a0", "i64 %count", *(f"i32 %{name}" for name in INDICES)])
    code, count = re.subn(r"define ptx_kernel void @march\(.*\)", f"define void @march({arguments})", code)
    assert count == 1
    return machine_code.function_of(code, "march", kind=THREAD)


class Driver:
    """The calls of the driver's library that are made, for a GPU that is the processor."""

    def __init__(self):
        self.memory, self.modules, self.launched, self.broken = {}, [], [], None

    def __getattr__(self, name):
        if name == self.broken:
            return lambda *_: 2
        if name in ("cuInit", "cuDeviceGet", "cuDevicePrimaryCtxRetain", "cuCtxSetCurrent", "cuCtxSynchronize"):
            return lambda *_: 0
        raise AttributeError(name)

    def cuGetErrorString(self, status, text):
        text._obj.value = b"out of memory"

    def cuMemAlloc_v2(self, found, size):
        array = np.full(-(-size.value // 8), np.nan)
        found._obj.value = array.ctypes.data
        self.memory[array.ctypes.data] = array
        return 0

    def cuMemFree_v2(self, address):
        self.memory.pop(address.value)[:] = np.nan
        return 0

    def cuMemcpyHtoD_v2(self, there, here, size):
        assert size.value <= self.memory[there.value].nbytes
        ctypes.memmove(there.value, here.value, size.value)
        return 0

    def cuMemcpyDtoH_v2(self, here, there, size):
        assert size.value <= self.memory[there.value].nbytes
        ctypes.memmove(here.value, there.value, size.value)
        return 0

    def cuModuleLoadDataEx(self, module, image, *options):
        self.modules.append((image.value.decode(), thread_of(image.value.decode())))
        module._obj.value = len(self.modules)
        return 0

    def cuModuleGetFunction(self, function, module, name):
        assert name == b"march"
        function._obj.value = module.value
        return 0

    def cuLaunchKernel(self, function, blocks, y, z, threads, v, w, shared, stream, arguments, extra):
        assert (y, z, v, w, shared, stream, extra) == (1, 1, 1, 1, 0, None, None)
        code, run = self.modules[function.value - 1]
        address, count = (ctypes.cast(at, ctypes.POINTER(ctypes.c_uint64))[0] for at in arguments)
        self.launched.append((code, count))
        for block in range(blocks):
            for thread in range(threads):
                run(address, count, block, threads, thread)
        return 0


class Codes(list):
    """The codes that a GPU is given; if they are poisoned, with functions that give NaN."""

    is_poisoned = False


@pytest.fixture
def codes(monkeypatch):
    found, code_of = Codes(), gpu.code_of

    def kept(*given):
        code = code_of(*given)
        for numbers in (elementary.HALF_PI, elementary.LN_2) if found.is_poisoned else ():
            code = code.replace(LITERALS["double"](numbers[1]), LITERALS["double"](np.nan))
        found.append(code)
        return code

    monkeypatch.setattr(gpu, "code_of", kept)
    return found


@pytest.fixture
def driver(monkeypatch):
    """The stand-in; it gets LLVM's code in place of PTX."""
    found = Driver()
    monkeypatch.setattr(gpu.ctypes, "CDLL", lambda _: found)
    monkeypatch.setattr(gpu, "ptx_of", lambda code: code)
    gpu.gpu.cache_clear()
    yield found
    gpu.gpu.cache_clear()
    assert not found.memory


def same(a, b):
    """Whether two datasets are the same to the bit."""
    return all(np.array_equal(x.values, b[name].values, equal_nan=x.dtype.kind == "f") for name, x in a.items())


def compared(codes, body, **how):
    """The datasets of the processor and of the GPU: the same to the bit where no function of the GPU is called."""
    how = {"material_angular_velocity": W, "t_end": 3, "step": 0.05, "variables": "all", "project": True} | how
    body = BODIES[body](1.0) if isinstance(body, str) else body
    expected, found = (nt.simulate_ensemble(body, device=device, **how) for device in ("cpu", "gpu"))
    assert codes
    assert (expected.status == 0).any()
    assert set(found.data_vars) == set(expected.data_vars)
    if same(expected, found):
        return expected, found
    if machine_code.is_fused():
        codes.is_poisoned = True
        assert not same(found, nt.simulate_ensemble(body, device="gpu", **how))
        codes.pop()
    for name, array in expected.data_vars.items():
        if array.dtype.kind == "f" and not name.endswith(("defect", "drift")):
            limit = 1e-12 * (1 + np.nanmax(abs(array.values)))
            np.testing.assert_allclose(found[name], array, rtol=0, atol=limit, err_msg=name)
    return expected, found


def require_ptx(code):
    """PTX of the code, in which products and sums say how they are rounded, so that nothing is contracted."""
    assert " x double>" not in code  # one lane
    ptx = ptx_of(code)
    for words in (".visible .entry march(", "fma.rn.f64", "mul.rn.f64"):
        assert words in ptx
    assert not re.findall(r"\b(mul|add|sub|fma)\.f64", ptx)
    return ptx


def switching(t, d, w):
    return np.interp(t, [0, 1, 2.5, 3], [0.1, 0.5, -0.3, 0.2]) * np.sin(d[0, 1]), np.exp(-w[0] * w[0]), np.cos(3 * w[1])


MORE = {
    "functions of C": lambda: nt.moment(switching, compiled=True) + 0.5 * nt.moment(of_state, compiled=True),
    "memory": lambda: nt.memory_load(fading, remembered, [0.1, 0.2], compiled=True),
    "ellipse and potential": lambda: (
        nt.gravity_gradient(0.6, (1, 1, 0), (0, 0, 1), 0.2, eccentricity=0.3) + LOADS["compiled potential"][0]()
    ),
    "body forces": lambda: nt.director_forces(TIMES, FORCES, frame="body") + nt.rotor("z", 0.7),
}


OUTPUTS = {"t_end": None, "times": [0, 0.02, 0.31, 1.3, 1.5, 1.9, 2.47, 3]}
STATISTICS = OUTPUTS | {"reduce": ("drift", "extrema", "averages", "total_twist")}
ALL = {"store": 1}
PAIRS = [  # each scheme, each part of a load, each kind of output
    ("gauss 2", "heavy top", "space table", OUTPUTS),
    ("gauss 4", "standard", "memory", ALL),
    ("gauss 6", "spin table", "body table", ALL),
    ("gauss 8", "suslov", "ellipse and potential", ALL),
    ("gauss 8", "heavy nontwisting", "none", {"step": None, "tolerance": 1e-9}),
    ("lie-midpoint 2", "nontwisting", "rotor table", STATISTICS),
    ("lie-midpoint 2", "standard", "functions of C", ALL),
    ("lie-midpoint 2 dissipative", "standard", "compiled forces", ALL),
    ("energy-momentum 2", "heavy nontwisting", "sum of all", ALL),
    ("energy-momentum 2", "suslov", "body forces", ALL),
    ("energy-momentum 1 dissipative", "heavy top", "quadratic", ALL),
]
PYTHON = ["moment", "moment in C", "forces", "potential"]
FORMER = [("gauss 16", "heavy suslov", "damping", ALL), ("lie-midpoint 1 dissipative", "symmetric", "sum", ALL)]
FORMER += [("energy-momentum 2 dissipative", "heavy top", "quadratic", ALL)]
EVERY = product(
    ("gauss 4", "lie-midpoint 2", "energy-momentum 2"),
    ("standard", "heavy nontwisting"),
    [load for load in LOADS if load not in PYTHON],
    [ALL],
)


@pytest.mark.parametrize(("scheme", "body", "load", "how"), or_long(PAIRS, [*EVERY, *FORMER]))
def test_thread_equals_processor(driver, codes, scheme, body, load, how):
    made = MORE[load]() if load in MORE else LOADS[load][0]()
    compared(codes, body, integrator=SCHEMES[scheme], load=made, load_scale=1 + 0.1 * np.arange(len(W)), **how)
    require_ptx(codes[-1])


@pytest.mark.skipif(PTXAS is None, reason="there is no ptxas")
@pytest.mark.parametrize("scheme", thinned(3, ["lie-midpoint 2", "gauss 4", "energy-momentum 2"]))
def test_the_assembler_takes_it(driver, codes, scheme, tmp_path):
    compared(codes, "standard", integrator=SCHEMES[scheme], load=MORE["functions of C"]())
    (tmp_path / "march.ptx").write_text(require_ptx(codes[-1]), encoding="utf-8")
    subprocess.run([PTXAS, "-arch=sm_80", "march.ptx"], cwd=tmp_path, check=True)


def test_pauses_and_kinds_of_motion(driver, codes, monkeypatch):
    """Loads are sampled for some steps at a time, and each kind of motion is a launch."""
    monkeypatch.setattr(stack_march, "NODES", 80)
    names = "standard", "heavy top", "sphere", "lagrange top", "standard"
    stack = nt.DirectorSystem.stack([BODIES[name](1.0) for name in names])
    compared(codes, stack, integrator="gauss", load=LOADS["body sine"][0](), material_angular_velocity=W[:5], store=7)
    assert [count for _, count in driver.launched] == [3, 2] * 3


def test_blocks_of_threads_continue(driver, codes):
    body, how = BODIES["standard"](1.0), {"integrator": "lie-midpoint", "t_end": 3, "step": 0.05}
    many = np.random.default_rng(5).normal(size=(150, 3))
    first, same = compared(codes, body, material_angular_velocity=many, **how)
    assert driver.launched[-1][1] == 150
    starts, how["t_end"] = ((first, "cpu"), (same, "gpu")), 5
    ends = [nt.simulate_ensemble(body, start=start, device=device, **how).quaternion for start, device in starts]
    np.testing.assert_allclose(*ends, rtol=0, atol=0 if machine_code.is_fused() else 1e-12)  # as `compared`


def root(t, d, w):
    return np.sqrt(1.5 - w[0]), 0, 0


@pytest.mark.parametrize("load", [None, nt.moment(root, compiled=True)])
def test_members_fail_as_on_processor(driver, codes, load):
    fast = W[0] * np.linspace(0.5, 60, 8)[:, None]
    _, found = compared(codes, "standard", integrator="lie-midpoint", load=load, material_angular_velocity=fast)
    assert 0 < (found.status != 0).sum() < 8


@pytest.mark.parametrize("name", ["sin", "cos", "exp"])
def test_functions(name, monkeypatch):
    """Within one unit in the last place, where a result is no denormal; the same on floats."""
    monkeypatch.setattr(machine_code, "is_fused", lambda: True)
    text, exact, rng = getattr(elementary, name), getattr(mpmath, name), np.random.default_rng(7)
    traced = Kernel(lambda x: text(x), "f8 -> f8")
    if name == "exp":
        given = [*rng.uniform(-1, 1, 100), *rng.uniform(-708, 709, 100), 0.0, -745.1, 5e-324]
        assert [traced(x) for x in (800.0, 709.9, np.inf, -800.0, -np.inf)] == [np.inf, np.inf, np.inf, 0.0, 0.0]
        assert np.isnan(traced(np.nan))
    else:
        multiples = np.outer([1, 3, -(2.0**20), 2.0**43], np.arange(1, 60)).ravel() * (np.pi / 4)
        given = [*rng.uniform(-4, 4, 100), *(10 ** rng.uniform(-20, 15.05, 100)), *multiples, 2.0**50]
        assert np.isnan([traced(x) for x in (np.nan, np.inf, 2.0**50 + 1)]).all()
    with mpmath.workprec(300):
        for x in map(float, given):
            y = traced(x)
            assert abs(mpmath.mpf(y) - exact(mpmath.mpf(x))) < 0.8 * np.spacing(abs(y)), x
            assert y == float(text(np.float64(x))), x


def test_functions_in_lanes():
    """Side by side as one by one: the text where the processor can fuse, else the C library."""
    x = np.random.default_rng(3).uniform(-1e4, 1e4, machine_code.lanes())

    @kernel("f8[:], f8[:], f8[:]")
    def both(x, s, c):
        sine, cosine = elementary.sine_and_cosine(x.load(0, lanes_of_text()))
        s.store(0, sine, lanes_of_text())
        c.store(0, cosine, lanes_of_text())

    s, c = np.zeros_like(x), np.zeros_like(x)
    both(x, s, c)
    one = (elementary.sin, elementary.cos) if machine_code.is_fused() else (math.sin, math.cos)
    assert [list(s), list(c)] == [[float(f(np.float64(y))) for y in x] for f in one]


HOW = {"t_end": 1, "step": 0.1, "material_angular_velocity": W, "device": "gpu"}
REFUSED = {
    "device": lambda: {"device": "tpu"},
    "split": lambda: {"integrator": "split"},
    "wheel": lambda: {"load": nt.wheel("z", 0.1, viscous=0.2)},
    "friction": lambda: {"load": nt.dry_friction(0.1), "integrator": "gauss"},
    **{name: lambda name=name: {"load": LOADS[name][0]()} for name in PYTHON},
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(driver, name):
    with says():
        nt.simulate_ensemble(BODIES["standard"](1.0), **HOW | REFUSED[name]())


def of_tangent(t, d, w):
    return np.tan(w[0]), 0, 0


def test_missing_functions(driver):
    load = nt.moment(of_tangent, compiled=True)
    with pytest.raises(
        ValueError, match=r"load of_tangent cannot .* a GPU has no tan here, but sin, cos, exp and sqrt"
    ):
        nt.simulate_ensemble(BODIES["standard"](1.0), **HOW, load=load)


def test_a_machine_without_a_gpu(driver, monkeypatch):
    body = BODIES["standard"](1.0)
    driver.broken = "cuInit"
    with refused("no-gpu", why="cuInit: out of memory"):
        nt.simulate_ensemble(body, **HOW)
    driver.broken = "cuCtxSynchronize"
    with refused("gpu-failed", call="cuCtxSynchronize"):
        nt.simulate_ensemble(body, **HOW)

    def missing(name):
        raise OSError(f"{name} is not there")

    monkeypatch.setattr(gpu.ctypes, "CDLL", missing)
    gpu.gpu.cache_clear()
    with refused("no-gpu"):
        nt.simulate_ensemble(body, **HOW)


@pytest.mark.parametrize("scheme", ["gauss 8", "lie-midpoint 2", "energy-momentum 2"])
def test_on_a_gpu(codes, scheme):
    """What a GPU gives, where there is one."""
    try:
        gpu.gpu()
    except InputError as error:
        pytest.skip(str(error))
    compared(codes, "heavy nontwisting", integrator=SCHEMES[scheme], load=LOADS["sum of all"][0](), reduce="extrema")
    compared(codes, "standard", integrator=SCHEMES[scheme], load=MORE["functions of C"](), **OUTPUTS)
