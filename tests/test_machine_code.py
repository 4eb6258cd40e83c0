"""Machine code wherever the package lies, and on other processors: the same bits, nothing kept on disk."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import nontwist
from nontwist import integrate, standard
from nontwist.kernels import machine_code

ROOT = Path(nontwist.__file__).parents[2]
FIRST = (
    "import sys; sys.path[:0] = [{path!r}]; import nontwist; early = 'llvmlite' in sys.modules;"
    "from nontwist import integrate, standard;"
    "run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3));"
    "print(run.director_velocities.sum().hex(), early, nontwist.__file__.startswith({path!r}))"
)


@pytest.fixture
def package(tmp_path):
    """A copy of the package, with its metadata."""
    shutil.copytree(ROOT / "src" / "nontwist", tmp_path / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
    metadata = tmp_path / "nontwist-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: nontwist\nVersion: 0\n", encoding="utf-8")
    return tmp_path


def first(path, *flags, **variables):
    """Return what a new process prints on stdout and stderr, without the variables that could help it."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG", "HOME", "PYTHON"))}
    command = [sys.executable, *flags, "-c", FIRST.format(path=str(path))]
    done = subprocess.run(command, env={**environment, **variables}, capture_output=True, text=True, check=False)
    return done.stdout, done.stderr


def expected():
    run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3))
    return f"{run.director_velocities.sum().hex()} False True\n"


def test_read_only_and_homeless_and_isolated(package):
    for inner in [package, *package.rglob("*")]:
        inner.chmod(0o555 if inner.is_dir() else 0o444)
    before = sorted(package.rglob("*"))
    try:
        assert first(package, HOME=str(package), PYTHONDONTWRITEBYTECODE="1") == (expected(), "")
        assert first(package, "-I", "-B") == (expected(), "")
        assert sorted(package.rglob("*")) == before
    finally:
        for inner in [package, *package.rglob("*")]:
            inner.chmod(0o755)


def test_in_an_archive(package):
    archive = shutil.make_archive(str(package / "packages"), "zip", package, "nontwist")
    assert first(archive) == (expected(), "")


@pytest.mark.parametrize(
    ("name", "features", "found", "lanes"),
    [
        ("cascadelake", "+avx,+avx2,+fma,+avx512f", "+avx,+avx2,+fma,+avx512f,+prefer-256-bit", 8),
        ("znver4", "+avx,+avx2,+fma,+avx512f", "+avx,+avx2,+fma,+avx512f", 8),
        ("haswell", "+avx,+avx2,+fma,-avx512f", "+avx,+avx2,+fma,-avx512f", 4),
        ("nehalem", "-avx,-fma", "-avx,-fma", 2),
    ],
)
def test_processors_have_the_vectors_that_are_fast_on_them(name, features, found, lanes, monkeypatch):
    llvm = SimpleNamespace(
        get_host_cpu_name=lambda: name,
        get_host_cpu_features=lambda: SimpleNamespace(flatten=lambda: features),
        get_process_triple=lambda: "x86_64-unknown-linux-gnu",
    )
    monkeypatch.setattr(machine_code, "_binding", lambda: llvm)
    machine_code.processor.cache_clear()
    try:
        assert machine_code.processor() == (name, found)
        assert machine_code.lanes() == lanes
        assert machine_code.is_fused() == ("+fma" in features)
    finally:
        machine_code.processor.cache_clear()
