"""Machine code wherever the package lies, and on other processors: the same bits, nothing kept on disk.

On aarch64 under QEMU, and with code for other processors of this kind: the memory that a march works on is copied into
one image at an address that both machines have free; there a program of a few lines calls the kernel, and writes the
image back. Needs `qemu-aarch64` and `aarch64-linux-gnu-gcc` (in Debian qemu-user and gcc-aarch64-linux-gnu), else it is
skipped.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from llvmlite import binding

import nontwist
from conftest import BODIES
from nontwist import Load, integrate, sine, standard
from nontwist.engine.records import BLOCK
from nontwist.engine.workspace import CALL, IN_BLOCK
from nontwist.integrators import INTEGRATORS, IVP
from nontwist.integrators.stack_march import StackMarch
from nontwist.kernels import machine_code
from nontwist.models.stack import stacked

HERE = Path(nontwist.__file__).parent


FIRST = (
    "import sys; sys.path[:0] = [{path!r}]; import nontwist; early = 'llvmlite' in sys.modules;"
    "from nontwist import integrate, standard;"
    "run = integrate(standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3));"
    "print(run.director_velocities.sum().hex(), early, nontwist.__file__.startswith({path!r}))"
)


@pytest.mark.parametrize("is_archive", [False, True])
def test_it_runs_read_only_and_homeless_and_isolated_and_in_an_archive(is_archive, tmp_path):
    shutil.copytree(HERE, tmp_path / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
    metadata = tmp_path / "nontwist-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: nontwist\nVersion: 0\n", encoding="utf-8")
    path = shutil.make_archive(str(tmp_path / "packages"), "zip", tmp_path, "nontwist") if is_archive else tmp_path
    before = sorted(tmp_path.rglob("*"))
    for inner in [tmp_path, *before]:
        inner.chmod(0o555 if inner.is_dir() else 0o444)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG", "HOME", "PYTHON"))}
    command = [sys.executable, "-I", "-B", "-c", FIRST.format(path=str(path))]
    environment["HOME"] = str(tmp_path)
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
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
    machine_code.processor.cache_clear()
    try:
        assert machine_code.processor() == (name, found)
        assert machine_code.lanes() == lanes
        assert machine_code.is_fused() == ("+fma" in features)
    finally:
        machine_code.processor.cache_clear()


LOADS = {"free": Load(), "sine": sine((1, 2, 0.5), 0.7), "sine in space": sine((1, 2, 0.5), 0.7, frame="space")}
AT, PAGE = 0x2000_0000_0000, 4096
HARNESS = r"""
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
void kernel(long);
int main(int count, char **given) {
    size_t size = strtoul(given[2], 0, 10);
    FILE *file = fopen(given[1], "r+b");
    char *memory = mmap((void *)PLACE, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1, 0);
    if (memory != (char *)PLACE || fread(memory, 1, size, file) != size) return 1;
    kernel(PLACE);
    rewind(file);
    return fwrite(memory, 1, size, file) != size;
}
"""


def image_of(block, arrays):
    """The block and the arrays as one piece of memory at `AT`, with its addresses; and where the results lie in it."""
    (results, at), *others = arrays
    parts, places = [(at, results), *((array.ctypes.data, array) for array in others)], [PAGE]
    for _, array in parts:
        places.append(places[-1] + -(-array.nbytes // PAGE) * PAGE)
    moved, image = block.copy(), bytearray(places[-1])
    for (address, array), place in zip(parts, places[:-1], strict=True):
        inside = (block >= address) & (block < address + array.nbytes)
        moved[inside] = AT + place + block[inside] - address
        image[place : place + array.nbytes] = array.tobytes()
    image[: block.nbytes] = moved.tobytes()
    assert block.nbytes <= PAGE
    return bytes(image), slice(places[0], places[0] + results.nbytes)


def prepared(name, order, body, load):
    """The kernel of a march of 20 steps, its block, and all the arrays that the block has addresses of."""
    scheme, found = INTEGRATORS[name](order=order), []
    system, W = BODIES[body](), np.array([6.0, -8.0, 0.0 if body == "nontwisting" else 1.0])
    if system.axis is not None:
        W -= (system.axis @ W) * system.axis
    start = np.eye(4)[3:], W[None]
    problem = IVP(stacked(system), *start, LOADS[load], 0.0, 1.0, 20, np.arange(21), intervals=True)
    sound = StackMarch._run

    def record(self, todo, width, first, last):
        block, workspace, _ = self.laid(todo, width, first, last)
        for name in IN_BLOCK:
            block[getattr(BLOCK, name)] = todo.arrays[0][0, getattr(CALL, name)]
        owned = [self.arrays["states"].base, self.sequence, self.stack.stored, self.bodies, self.scales, self.sizes]
        fractions = [gamma for gamma, _ in self.stages.values()]
        owned += [a for a in (self.table, self.lengths, workspace, *self.loads, *fractions) if a is not None]
        found.append((self.kernel(self.groups[0], width), block, [np.ascontiguousarray(a) for a in owned]))
        found[-1][2][0] = found[-1][2][0].copy(), found[-1][2][0].ctypes.data
        sound(self, todo, width, first, last)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StackMarch, "_run", record)
        scheme.march(problem)
    assert len(found) == 1
    return found[0]


SCHEMES = [("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4), ("gauss", 16), ("split", 4)]


def computed(folder, compiler, emulator, kernel, triple, processor, image):
    """The image after the kernel has worked on it, compiled for a processor with a fused multiply-add."""
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    module = binding.parse_assembly(kernel.code(is_fused=True))
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=processor, opt=3, reloc="static", codemodel="default"
    )
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    (folder / "harness.c").write_text(HARNESS.replace("PLACE", f"{AT}UL"), encoding="utf-8")
    (folder / "kernel.o").write_bytes(machine.emit_object(module))
    (folder / "image").write_bytes(image)
    command = [compiler, "-static", "-no-pie", "-O1", "harness.c", "kernel.o", "-lm", "-o", "harness"]
    subprocess.run(command, cwd=folder, check=True)
    subprocess.run([*emulator, "./harness", "image", str(len(image))], cwd=folder, check=True)
    return (folder / "image").read_bytes()


SCHEMES = [("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4), ("gauss", 16), ("split", 4)]
CASES = [(*one, body) for one in SCHEMES for body in BODIES if (one[0], body) != ("split", "suslov")]
X86, ARM = "x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"
PROCESSORS = {"haswell": "fma", "skylake-avx512": "avx512f", "znver2": "fma", "znver4": "avx512f"}


@pytest.mark.long
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize(("name", "order", "body"), CASES)
def test_other_processors_give_the_same_bits(name, order, body, load, tmp_path):
    """Those of this kind that this one contains, and an emulated one of another kind, where there is an emulator."""
    if not binding.get_process_triple().startswith("x86_64") or not shutil.which("gcc"):
        pytest.skip("needs x86-64 and gcc")
    features = binding.get_host_cpu_features()
    kernel, block, arrays = prepared(name, order, body, load)
    image, results = image_of(block, arrays)
    ways = [("gcc", [], X86, one) for one, feature in PROCESSORS.items() if features.get(feature)]
    compiler, emulator = "aarch64-linux-gnu-gcc", "qemu-aarch64"
    if shutil.which(compiler) and shutil.which(emulator):
        ways.append((compiler, [emulator], ARM, "generic"))
    start, (first, *others) = (
        np.frombuffer(image[results]),
        [
            np.frombuffer(computed(tmp_path, gcc, emulated, kernel, triple, one, image)[results])
            for gcc, emulated, triple, one in ways
        ],
    )
    assert not np.array_equal(first, start)  # the kernel has worked
    for other in others:
        assert np.array_equal(first, other, equal_nan=True)


LEVELS = """
import sys
from nontwist import damping, heavy_top, integrate, sine
from nontwist.kernels import machine_code
machine_code.LEVEL = int(sys.argv[1])
J, load = [[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]], sine((1, 2, 0.5), 0.7, frame="space") + damping(0.1)
how = dict(t_end=1, times=[0, 0.37, 1], step=0.05, material_angular_velocity=(6, -8, 0), load=load)
for name, order in ("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4):
    run = integrate(heavy_top(J, 0.3, (0, 0.1, 0.4)), integrator=name, order=order, **how)
    print(run.directors.tobytes().hex(), run.director_velocities.tobytes().hex())
"""


def test_what_is_done_for_speed_changes_no_bit():
    run = [subprocess.run([sys.executable, "-c", LEVELS, level], capture_output=True, check=True) for level in "01"]
    assert len(set(run[0].stdout.split())) == 6
    assert run[0].stdout == run[1].stdout
