"""Kernels as bitcode: complete, whole, fresh, the same as what Numba compiles, and wherever the package lies."""

import inspect
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tomllib
from contextlib import suppress
from functools import cache
from gzip import decompress
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from llvmlite import binding
from packaging.specifiers import SpecifierSet

import nontwist
from conftest import random_inertia, without_waiting
from nontwist import (
    INTEGRATORS,
    Load,
    SimulationError,
    closed_frame,
    damping,
    exact,
    frame_error_estimate,
    integrate,
    moment,
    simulate_ensemble,
    sine,
    solid_angle,
    standard,
)
from nontwist.bitcode import building, lowering
from nontwist.geometry import compiled, machine_code
from nontwist.geometry.machine_code import UnusableError
from nontwist.kernels.signatures import Signature
from test_kernels import KINDS

ROOT = Path(nontwist.__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
HOME = Path(machine_code.HOME)
MANIFEST = json.loads((HOME / machine_code.MANIFEST).read_text(encoding="utf-8"))
# Of the C library: functions, and what stands for loops that copy.
ALLOWED = {"sqrt", "sin", "cos", "tan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "pow", "fma", "floor", "fmod"}
ALLOWED |= {"sincos", "memset", "memcpy", "memmove"}
FIRST = (
    "import sys; sys.path[:0] = [{path!r}]; import nontwist; from nontwist import integrate, standard;"
    "run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3));"
    "print(run.director_velocities.sum().hex(), 'numba' in sys.modules, nontwist.__file__.startswith({path!r}))"
)


def kernels():
    return [kernel for module in building.modules() for kernel in building.kernels(module).values()]


def test_no_declared_kernel_is_missing():
    wanted = [
        machine_code.file_of(target, kernel.__module__, kernel.py_func.__name__)
        for kernel in kernels()
        for target in lowering.TARGETS
    ]
    assert len(wanted) == 2 * 4
    assert sorted(MANIFEST["files"]) == sorted(wanted)
    assert all((HOME / file).is_file() for file in wanted)


def test_every_kernel_that_is_called_from_python_declares_what_with():
    names = [path.relative_to(ROOT / "src").with_suffix("") for path in (ROOT / "src" / "nontwist").rglob("*.py")]
    modules = [import_module(".".join(name.parts)) for name in names if name.name not in ("__init__", "__main__")]
    found = {v for module in modules for v in vars(module).values() if isinstance(v, compiled.Kernel) and v.is_kernel}
    assert found == set(kernels())
    assert [kernel.name for kernel in found if kernel.signature is None] == []


def test_bitcode_of_all_kernels_is_small():
    assert sum((HOME / file).stat().st_size for file in MANIFEST["files"]) < 4e6


@pytest.mark.parametrize("target", lowering.TARGETS)
def test_symbols_are_those_of_the_c_library(target):
    """Of every file, and no intrinsic of a processor: what LLVM may split or turn into calls as it needs."""
    for file, entry in MANIFEST["files"].items():
        if file.startswith(target):
            assert set(entry["symbols"]) <= ALLOWED, file
            names = [f.name for f in binding.parse_bitcode(decompress((HOME / file).read_bytes())).functions]
            assert [name for name in names if not name.startswith("llvm.") and name != machine_code.ENTRY] == [
                name for name in names if re.fullmatch(r"_\d+", name) or name in ALLOWED
            ], file
            assert not [name for name in names if re.match(r"llvm\.(x86|aarch64)", name)], file


STEPS = ("integrators.gauss_linear.loaded_steps",)  # takes longer to compile


@pytest.mark.parametrize(
    "name", ["engine.linear.forward", *(pytest.param(name, marks=pytest.mark.long) for name in STEPS)]
)
def test_bitcode_does_not_depend_on_the_processor_that_makes_it(name):
    module, kernel = f"nontwist.{name}".rsplit(".", 1)
    code = (
        "from hashlib import sha256; from nontwist.bitcode import building as b, lowering as l;"
        f"k = b.kernels({module!r})[{kernel!r}]; m = l.lowered(k);"
        "from gzip import compress; "
        "print(*(sha256(compress(l.bitcode(m, t, k.unroll, k.vectorize)[0], mtime=0)).hexdigest() for t in l.TARGETS))"
    )
    generic = {**os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    done = subprocess.run([sys.executable, "-c", code], env=generic, capture_output=True, text=True, check=True)
    files = [machine_code.file_of(target, module, kernel) for target in lowering.TARGETS]
    assert done.stdout.split() == [MANIFEST["files"][file]["sha256"] for file in files]


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the bitcode, which `machine_code` then takes."""
    shutil.copytree(HOME, tmp_path / "bitcode")
    monkeypatch.setattr(machine_code, "HOME", tmp_path / "bitcode")
    for cached in (machine_code._manifest, machine_code._is_fresh):
        cached.cache_clear()
    yield tmp_path / "bitcode"
    for cached in (machine_code._manifest, machine_code._is_fresh):
        cached.cache_clear()


def damaged(data, rng):
    """Bytes that are not `data`: cut, lengthened, of zeros, or with some bits or a stretch changed."""
    kind = rng.choice(["cut", "longer", "zeros", "bit", "stretch", "empty", "swapped"])
    at, end = sorted(rng.sample(range(len(data)), 2))
    made = {
        "cut": data[:at],
        "longer": data + rng.randbytes(at + 1),
        "zeros": bytes(len(data)),
        "bit": data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :],
        "stretch": data[:at] + rng.randbytes(end - at) + data[end:],
        "empty": b"",
        "swapped": data[end:] + data[:end],
    }[kind]
    return made if made != data else data + b"\0"


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.long)])
def test_no_damaged_file_reaches_llvm(count, copied, monkeypatch):
    def parse(data):
        raise AssertionError("LLVM has seen it")

    monkeypatch.setattr(binding, "parse_bitcode", parse)
    rng, own = random.Random(20), kernels()
    target = machine_code.TARGETS[binding.get_process_triple().split("-")[0]]
    for _ in range(count):
        kernel = rng.choice(own)
        about = kernel.__module__, kernel.py_func.__name__
        path = copied / machine_code.file_of(target, *about)
        sound = path.read_bytes()
        path.write_bytes(damaged(sound, rng))
        with pytest.raises(UnusableError, match=r"^is damaged$"):
            machine_code.function(*about)
        path.write_bytes(sound)
    with pytest.raises(AssertionError, match="LLVM has seen it"):
        machine_code.function(*about)


ABOUT = "nontwist.engine.linear", "forward"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda home, file: file.unlink(), "cannot be read (No such file or directory)"),
        (lambda home, file: (file.unlink(), file.mkdir()), "cannot be read (Is a directory)"),
        (lambda home, file: (home / "manifest.json").unlink(), "is missing"),
        (lambda home, file: (home / "manifest.json").write_text("{", encoding="utf-8"), "is damaged"),
        (lambda home, file: (home / "manifest.json").write_text("[]", encoding="utf-8"), "is damaged"),
        (lambda home, file: edited(home, llvm=[99, 1, 0]), "needs LLVM 99.1.0: pip install --upgrade llvmlite"),
        (lambda home, file: edited(home, files={}), "is missing"),
        (lambda home, file: edited(home, texts={}), "is older than its text"),
    ],
)
def test_what_cannot_be_used_is_named(change, words, copied):
    target = machine_code.TARGETS[binding.get_process_triple().split("-")[0]]
    change(copied, copied / machine_code.file_of(target, *ABOUT))
    with pytest.raises(UnusableError, match=f"^{re.escape(words)}$"):
        machine_code.function(*ABOUT)


def edited(home, **entries):
    (home / "manifest.json").write_text(json.dumps({**MANIFEST, **entries}), encoding="utf-8")


def test_a_symbol_that_a_machine_lacks_is_named(copied):
    files = {file: {**entry, "symbols": ["nowhere_at_all"]} for file, entry in MANIFEST["files"].items()}
    edited(copied, files=files)
    with pytest.raises(UnusableError, match=r"^needs nowhere_at_all, which this machine lacks$"):
        machine_code.function(*ABOUT)


def test_another_processor_has_none(copied, monkeypatch):
    monkeypatch.setattr(binding, "get_process_triple", lambda: "riscv64-unknown-linux-gnu")
    with pytest.raises(UnusableError, match=r"^was not made for riscv64$"):
        machine_code.function(*ABOUT)


def test_a_processor_without_avx2_and_fma_gives_the_same_bits():
    code = (
        "import sys; from nontwist.geometry import machine_code as m; from nontwist import *;"
        "m.processor = lambda: ('x86-64', '') if sys.argv[1:] else m.binding_of();"
        "run = integrate(heavy_top([3, 4, 5], 1, (0, 0, 1)), t_end=1, step=0.05, integrator='gauss', order=8, "
        "material_angular_velocity=(1, 2, 3)); print(run.director_velocities.tobytes().hex(), m._machine().triple)"
    ).replace("m.binding_of()", "(sys.modules['llvmlite.binding'].get_host_cpu_name(), '')")
    if not binding.get_process_triple().startswith("x86_64"):
        pytest.skip("a processor of another kind")
    plain, own = (
        subprocess.run([sys.executable, "-c", code, *more], capture_output=True, text=True, check=True).stdout
        for more in (["plain"], [])
    )
    assert plain == own


# ---- the package in other places


@pytest.fixture
def package(tmp_path):
    """A copy of the package, with its metadata."""
    shutil.copytree(ROOT / "src" / "nontwist", tmp_path / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
    metadata = tmp_path / "nontwist-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: nontwist\nVersion: 0\n", encoding="utf-8")
    return tmp_path


def first(path, *flags, code=FIRST, **variables):
    """Return what a new process prints on stdout and stderr, without the variables that could help it.

    On a slow machine it may say as well what it loads.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG", "HOME", "PYTHON"))}
    command = [sys.executable, *flags, "-c", code.format(path=str(path))]
    done = subprocess.run(command, env={**environment, **variables}, capture_output=True, text=True, check=False)
    return done.stdout, without_waiting(done.stderr)


def expected():
    run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3))
    return f"{run.director_velocities.sum().hex()} False True\n"


def test_read_only_and_homeless_and_isolated(package):
    for inner in [package, *package.rglob("*")]:
        inner.chmod(0o555 if inner.is_dir() else 0o444)
    try:
        assert first(package, HOME=str(package)) == (expected(), "")
        assert first(package, "-I") == (expected(), "")
    finally:
        for inner in [package, *package.rglob("*")]:
            inner.chmod(0o755)


def test_in_an_archive(package):
    archive = shutil.make_archive(str(package / "packages"), "zip", package, "nontwist")
    assert first(archive) == (expected(), "")


def test_without_numba_a_run_is_the_same(package):
    (package / "numba.py").write_text("raise ImportError('no numba')", encoding="utf-8")
    assert first(package) == (expected(), "")


def test_without_bitcode_and_numba_a_run_is_the_same(package):
    (package / "numba.py").write_text("raise ImportError('no numba')", encoding="utf-8")
    shutil.rmtree(package / "nontwist" / "bitcode")
    assert first(package) == (expected(), "")


def test_what_takes_more_than_a_second_is_said(capsys, monkeypatch):
    patience = 1.0
    source = inspect.getsource(compiled)
    assert f"PATIENCE = {patience}  # s" in source
    monkeypatch.setattr(compiled, "PATIENCE", patience)

    class Now:
        def __init__(self, seconds, function, arguments):
            assert seconds == patience
            self.start = lambda: function(*arguments)

        def cancel(self):
            pass

    monkeypatch.setattr(compiled, "Timer", Now)
    kernel = compiled.Kernel(lambda x: x + 1.0, is_kernel=True, signature="f8 -> f8")
    monkeypatch.setattr(compiled, "_said", set())
    assert kernel(1.0) == 2.0
    name = f"{__name__}.<lambda>"
    assert capsys.readouterr().err.splitlines() == [
        "nontwist: loading compiled code ...",
        f"nontwist: compiling the kernel {name} ...",
        f"nontwist: the machine code of {name} is missing: Numba compiles what is needed",
    ]
    second = compiled.Kernel(lambda x: x + 2.0, is_kernel=True, signature="f8 -> f8")
    assert second(1.0) == 3.0
    assert capsys.readouterr().err == f"nontwist: compiling the kernel {name} ...\n"


# ---- JIT and bitcode


@pytest.fixture
def by_numba(monkeypatch):
    """Return a function that switches bitcode off and back on."""

    def switch(off):
        def none(*about):
            raise UnusableError("is switched off")

        monkeypatch.setattr(compiled, "_said", {"said"})
        monkeypatch.setattr(machine_code, "function", none if off else function)
        for kernel in kernels():
            vars(kernel).pop("ready", None)

    function = machine_code.function
    yield switch
    switch(False)


def problems(seed):
    """A generated problem of one body, or of nine, and how to run it."""
    rng = np.random.default_rng(seed)
    name = rng.choice([name for name in INTEGRATORS if name != "continuous"])
    make = KINDS[rng.choice(["standard", "nontwisting"] if name in ("exact", "split") else list(KINDS))]
    a, b, f, c = rng.normal(size=3), rng.normal(size=3), rng.uniform(0.5, 3), rng.uniform(0, 0.3, size=3)
    loads = [Load(), sine(a, f), sine(b, f, frame="space"), damping(c), pull()]
    load = Load() if name == "exact" else sum((loads[i] for i in rng.choice(5, size=2)), Load())
    members = int(rng.choice([1, 9]))
    start = {"material_angular_velocity": rng.normal(size=(members, 3))[0 if members == 1 else slice(None)]}
    orders = INTEGRATORS[name].orders
    order = {"order": int(rng.choice(orders))} if len(orders) > 1 else {}
    how = {"t_end": 0.3, "step": 0.3 / int(10 ** rng.uniform(0.5, 2)), "integrator": name, "project": True}
    return make(rng), {**how, **start, **order, "load": load}, members


@cache
def pull():
    return moment(lambda t, d, w: (d[2, 1] * np.sin(t), -d[2, 0], 0.1 * t), compiled=True)


def bits(seed):
    """A hash of what a problem comes to, or the words in which it is refused."""
    body, how, members = problems(seed)
    try:
        run = (integrate if members == 1 else simulate_ensemble)(body, **how)
    except (ValueError, SimulationError) as refused:
        return str(refused)
    if members == 1:
        arrays = [run.director_velocities, run.directors, run.multipliers, run.load_work]
    else:
        arrays = [run[name].values for name in sorted(run.data_vars) if run[name].dtype == float]
    return sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def others(seed):
    """The bits of frames, solid angles and closed solutions of random data."""
    rng = np.random.default_rng(seed)
    d3 = rng.normal(size=(3, 40, 3)).cumsum(axis=1)
    d3 /= np.linalg.norm(d3, axis=-1, keepdims=True)
    frames, holonomy = closed_frame(d3)
    J, W, times = random_inertia(rng), rng.normal(size=3), np.linspace(0, 9, 20)
    arrays = [frames, holonomy, frame_error_estimate(d3), solid_angle(d3), solid_angle(d3, pole=rng.normal(size=3))]
    arrays += [*exact.free_standard(J, W, times), *exact.free_nontwisting([3, 4, 5], W * [1, 1, 0], times)]
    arrays += [*exact.suslov(J, [0, 0, 1], W * [1, 1, 0], times), exact.montgomery_angle(J, W)]
    return [np.asarray(array).tobytes() for array in arrays]


FEW = [2]  # of problems, with a kernel that Numba compiles for the comparison


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seeds", [FEW, pytest.param(range(1000), marks=pytest.mark.long)], ids=["few", "many"])
def test_numba_and_bitcode_give_the_same_bits(seeds, by_numba):
    def all_bits():
        return [bits(seed) for seed in seeds], [others(seed) for seed in range(len(seeds) - 1)]

    found = all_bits()
    by_numba(True)
    assert all_bits() == found
    assert sum(" " not in one for one in found[0]) > 0.8 * len(seeds)  # are runs, not refused


def test_the_hook_finds_the_package_where_an_editable_install_is_made_again(tmp_path, monkeypatch):
    """Pip takes the folders of the install that is there off the path, those of PYTHONPATH too."""
    interface, calls = ModuleType("interface"), []
    interface.BuildHookInterface = object
    for name in ("hatchling", "hatchling.builders", "hatchling.builders.hooks", "hatchling.builders.hooks.plugin"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "hatchling.builders.hooks.plugin.interface", interface)
    monkeypatch.syspath_prepend(ROOT)
    monkeypatch.setattr(subprocess, "run", lambda *args, **how: calls.append((args, how)))
    hook = import_module("hatch_build").CustomBuildHook()
    hook.root = str(ROOT)
    hook.initialize("editable", {})
    monkeypatch.undo()
    ((command,), how) = calls[0]
    source = str(ROOT / "src")
    (tmp_path / "sitecustomize.py").write_text(
        f"import sys; sys.path = [p for p in sys.path if p != {source!r}]", encoding="utf-8"
    )
    how["env"] = {**how.get("env", os.environ), "PYTHONPATH": str(tmp_path)}
    assert command[1:] == ["-m", "nontwist.bitcode"]
    command[1:] = ["-c", "import nontwist.bitcode as found; print(found.__file__)"]
    done = subprocess.run(command, **how, capture_output=True, text=True)
    assert Path(done.stdout.strip()).parent == HOME


def test_the_build_and_the_run_agree_on_versions():
    pins = dict(re.fullmatch(r"([\w-]+)==([\d.]+)", word).groups() for word in PROJECT["build-system"]["requires"])
    wanted = dict(re.fullmatch(r"([\w-]+)>=([\d.]+)", word).groups() for word in PROJECT["project"]["dependencies"])
    extra = dict(
        re.fullmatch(r"([\w-]+)>=([\d.]+)", word).groups()
        for word in PROJECT["project"]["optional-dependencies"]["compile"]
    )
    constraints = dict(
        line.split("==") for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if "==" in line
    )
    parts = {name: tuple(map(int, text.split("."))) for name, text in pins.items()}
    assert parts["llvmlite"][: wanted["llvmlite"].count(".") + 1] == tuple(map(int, wanted["llvmlite"].split(".")))
    assert parts["numba"][: extra["numba"].count(".") + 1] == tuple(map(int, extra["numba"].split(".")))
    for name in ("llvmlite", "numba", "numpy"):
        assert pins[name] == constraints[name]
    if version("llvmlite") == pins["llvmlite"]:
        assert MANIFEST["llvm"] == list(binding.llvm_version_info)


def test_pinned_packages_accept_every_python_that_the_package_does():
    """Else `make` fails where Python is 3.11.2, as on Debian 12, though the package accepts it."""
    least = PROJECT["project"]["requires-python"].removeprefix(">=")
    refusing = []
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        name, sign, pinned = line.partition("==")
        with suppress(PackageNotFoundError):
            found = distribution(name)
            if sign and found.version == pinned:
                accepted = SpecifierSet(found.metadata.get("Requires-Python") or "")
                refusing += [line] * (not accepted.contains(f"{least}.0"))
    assert refusing == []


# ---- signatures


def test_the_words_of_a_signature():
    found = Signature("f8[:, :], f8, i8[:] -> i8, f8")
    assert not found.is_address
    assert found.places == [("f8", 0, 2), ("f8", 3, 0), ("i8", 4, 1)]
    assert found.results == [("i8", 6, 0), ("f8", 7, 0)]
    for words in ("f4", "f8[:,:]", "f8[]", "i8 ->", "f8; i8"):
        with pytest.raises(ValueError, match="is not what a kernel takes"):
            Signature(words)
