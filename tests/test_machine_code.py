"""Machine code wherever the package lies, and on other processors: the same bits, nothing kept on disk."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import nontwist
from conftest import PAPER_J
from nontwist import damping, heavy_top, integrate, sine, standard
from nontwist.integrators import stack_march
from nontwist.kernels import machine_code

HERE = Path(nontwist.__file__).parent


FIRST = (
    "import sys; sys.path[:0] = [{path!r}]; import nontwist; early = 'llvmlite' in sys.modules;"
    "run = nontwist.integrate(nontwist.standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3));"
    "print(run.director_velocities.sum().hex(), early, nontwist.__file__.startswith({path!r}))"
)


def test_it_runs_read_only_and_homeless_and_isolated_in_an_archive(tmp_path):
    shutil.copytree(HERE, tmp_path / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
    path = shutil.make_archive(str(tmp_path / "packages"), "zip", tmp_path, "nontwist")
    before = sorted(tmp_path.rglob("*"))
    for inner in [tmp_path, *before]:
        inner.chmod(0o555 if inner.is_dir() else 0o444)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG", "HOME", "PYTHON"))}
    command = [sys.executable, "-I", "-B", "-c", FIRST.format(path=path)]
    try:
        done = subprocess.run(command, env=environment | {"HOME": str(tmp_path)}, capture_output=True, text=True)
        assert sorted(tmp_path.rglob("*")) == before
    finally:
        for inner in [tmp_path, *before]:
            inner.chmod(0o755)
    run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3))
    assert (done.stdout, done.stderr) == (f"{run.director_velocities.sum().hex()} False True\n", "")


@pytest.mark.parametrize(
    ("name", "features", "found", "lanes"),
    [
        ("cascadelake", "+avx,+avx2,+fma,+avx512f", "+avx,+avx2,+fma,+avx512f,+prefer-256-bit", 8),
        ("znver4", "+avx,+avx2,+fma,+avx512f", "+avx,+avx2,+fma,+avx512f", 8),
        ("haswell", "+avx,+avx2,+fma,-avx512f", "+avx,+avx2,+fma,-avx512f", 4),
        ("nehalem", "-avx,-fma", "-avx,-fma", 2),
        ("core2", "+sse2", "+sse2", 2),
    ],
)
def test_processors_have_the_vectors_that_are_fast_on_them(name, features, found, lanes, monkeypatch):
    llvm = SimpleNamespace(
        get_host_cpu_name=lambda: name,
        get_host_cpu_features=lambda: SimpleNamespace(flatten=lambda: features),
        get_process_triple=lambda: "x86_64-unknown-linux-gnu",
    )
    monkeypatch.setattr(machine_code, "binding", lambda: llvm)
    monkeypatch.setattr(machine_code, "processor", machine_code.processor.__wrapped__)
    assert machine_code.processor() == (name, found)
    assert machine_code.lanes() == lanes
    assert machine_code.is_fused() == ("+fma" in features)


CASES = [("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4), ("gauss", 16), ("split", 4)]
PROCESSORS = {"haswell": "+avx,+avx2,+fma", "znver2": "+avx,+avx2,+fma", "skylake-avx512": "+avx,+avx2,+fma,+avx512f"}


@pytest.mark.parametrize(("name", "order"), CASES)
def test_what_is_done_for_speed_and_other_processors_change_no_bit(name, order, monkeypatch):
    """Processors of this kind that this one contains."""
    monkeypatch.setattr(stack_march, "march_kernel", stack_march.march_kernel.__wrapped__)
    load, own = sine((1, 2, 0.5), 0.7, frame="space") + damping(0.1), machine_code.processor()
    how = {"t_end": 1, "times": [0, 0.37, 1], "step": 0.05, "load": load, "integrator": name, "order": order}
    known = {one: words for one, words in PROCESSORS.items() if {*words.split(",")} <= {*own[1].split(",")}}
    found = set()
    for level, processor in ((0, own), *((1, one) for one in (own, *known.items()))):
        monkeypatch.setattr(machine_code, "LEVEL", level)
        monkeypatch.setattr(machine_code, "processor", lambda processor=processor: processor)
        run = integrate(heavy_top(PAPER_J, 0.3, (0, 0.1, 0.4)), material_angular_velocity=(6, -8, 0), **how)
        found.add((run.directors.tobytes(), run.director_velocities.tobytes()))
    assert len(found) == 1
