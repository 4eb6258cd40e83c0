"""Machine code wherever the package lies, and on other processors: the same bits, nothing kept on disk."""

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from llvmlite import binding

import nontwist
from conftest import BODIES, PAPER_J, or_long
from nontwist import Load, damping, heavy_top, integrate, propagator, sine, standard
from nontwist.engine.records import BLOCK
from nontwist.engine.workspace import CALL, IN_BLOCK, enter
from nontwist.integrators import INTEGRATORS, IVP, dense, stack_march
from nontwist.kernels import machine_code
from nontwist.models.stack import stacked

HERE = Path(nontwist.__file__).parent


FIRST = (
    "import sys; sys.path[:0] = [{path!r}]; import nontwist; early = 'llvmlite' in sys.modules;"
    "run = nontwist.integrate(nontwist.standard([3, 4, 5]), t_end=1, step=0.01, material_angular_velocity=(1, 2, 3));"
    "print(run.director_velocities.sum().hex(), early, nontwist.__file__.startswith({path!r}))"
)


@pytest.mark.parametrize("is_archive", [False, True])
def test_read_only_homeless_isolated_archived(is_archive, tmp_path):
    shutil.copytree(HERE, tmp_path / "nontwist", ignore=shutil.ignore_patterns("__pycache__"))
    path = shutil.make_archive(str(tmp_path / "packages"), "zip", tmp_path, "nontwist") if is_archive else str(tmp_path)
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
def test_vectors_of_processors(name, features, found, lanes, monkeypatch):
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


@pytest.mark.parametrize(("name", "order"), or_long([CASES[0], *CASES[2:3], CASES[4]], [CASES[1], CASES[3]]))
def test_optimisation_changes_no_bit(name, order, monkeypatch):
    """Processors of this kind that this one contains."""
    monkeypatch.setattr(stack_march, "march_kernel", stack_march.march_kernel.__wrapped__)
    monkeypatch.setattr(dense, "output_kernel", dense.output_kernel.__wrapped__)
    load, own = sine((1, 2, 0.5), 0.7, frame="space") + damping(0.1), machine_code.processor()
    how = {"t_end": 1, "times": [0, 0.37, 1], "step": 0.05, "load": load, "integrator": name, "order": order}
    known = {one: words for one, words in PROCESSORS.items() if {*words.split(",")} <= {*own[1].split(",")}}
    found = set()
    for level, processor in ((0, own), *((1, one) for one in (own, *known.items()))):
        monkeypatch.setattr(machine_code, "LEVEL", level)
        monkeypatch.setattr(machine_code, "ENOUGH", 0)
        monkeypatch.setattr(machine_code, "processor", lambda processor=processor: processor)
        run = integrate(heavy_top(PAPER_J, 0.3, (0, 0.1, 0.4)), material_angular_velocity=(6, -8, 0), **how)
        found.add((run.directors.tobytes(), run.director_velocities.tobytes()))
    assert len(found) == 1


def test_better_code_after_many_steps(monkeypatch):
    """Of kernels, and of marches that are kept with the addresses of theirs."""
    how = {"t_end": 1.3, "step": 0.1, "material_angular_velocity": (1, 2, 3)}
    integrate(standard([2, 3, 4]), **how)
    assert enter.address  # what is called around marches is made
    levels, made = [], machine_code.function_of
    monkeypatch.setattr(machine_code, "LEVEL", 1)
    monkeypatch.setattr(machine_code, "ENOUGH", 50)
    monkeypatch.setattr(stack_march, "march_kernel", cache(stack_march.march_kernel.__wrapped__))

    def noted(*arguments, level=None):
        levels.append(level)
        return made(*arguments, level=level)

    monkeypatch.setattr(machine_code, "function_of", noted)
    runs = [integrate(standard([2, 3, 4.03125]), **how).directors.tobytes() for _ in range(5)]
    assert levels == [machine_code.QUICK, None]
    assert len(set(runs)) == 1
    propagator(standard([2, 3, 4]), t_end=1.3, step=0.1, integrator="lie-midpoint")
    assert levels[2:] == [None]


def test_pure_line_is_written_once():
    tracer = machine_code.Tracer(1, False)
    tracer.open("f", "double %a")
    names = [tracer.value("fadd double %a, %a") for _ in range(2)]
    others = [tracer.value("call double @g(double %a)", False) for _ in range(2)]
    assert (len({*names}), len({*others}), len(tracer.function.lines)) == (1, 2, 3)


AT, PAGE, FUSED = 0x2000_0000_0000, 4096, "+fma" in machine_code.processor()[1]
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


def marched(scheme, body, load):
    """The kernel of a march of 20 steps, its block before, and the arrays that the block has addresses of."""
    system, W, found = BODIES[body](), np.array([6.0, -8.0, 0.0 if body == "nontwisting" else 1.0]), []
    W = W if system.axis is None else W - (system.axis @ W) * system.axis
    run = stack_march.StackMarch._run

    def record(self, todo, width, first, last):
        block, workspace, _ = self.laid(todo, width, first, last)
        for name in IN_BLOCK:
            block[getattr(BLOCK, name)] = todo.values["rows"][0, getattr(CALL, name)]
        fractions = [gamma for gamma, _ in self.stages.values()]
        owned = [self.sequence, self.stack.stored, self.bodies, self.scales, self.sizes, self.table, self.lengths]
        owned = [a for a in (*owned, workspace, *self.loads, *fractions) if a is not None]
        states = self.arrays["states"].base
        arrays = [(states.ctypes.data, states.copy()), *((a.ctypes.data, np.ascontiguousarray(a)) for a in owned)]
        found.append((self.kernel(self.groups[0], width), block, arrays))
        run(self, todo, width, first, last)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stack_march.StackMarch, "_run", record)
        problem = IVP(stacked(system), np.eye(4)[3:], W[None], load, 0.0, 1.0, 20, np.arange(21), intervals=True)
        march = stack_march.StackMarch(problem, scheme)
        march.run()
    return (*found[0], march.arrays["states"].base)


def image_of(block, arrays, at=AT):
    """The block and the arrays as one piece of memory at an address, with its own; and where the states lie in it."""
    places = PAGE * np.cumsum([1, *(-(-array.nbytes // PAGE) for _, array in arrays)])
    moved, image = block.copy(), bytearray(places[-1])
    for (address, array), place in zip(arrays, places[:-1].tolist(), strict=True):
        inside = (block >= address) & (block < address + array.nbytes)
        moved[inside] = at + place + block[inside] - address
        image[place : place + array.nbytes] = array.tobytes()
    image[: block.nbytes] = moved.tobytes()
    return bytes(image), slice(PAGE, PAGE + arrays[0][1].nbytes)


@pytest.mark.parametrize(("name", "order"), CASES)
def test_march_lives_in_image(name, order):
    """What is carried to other machines below: all that the kernel reads, and nothing that it has written."""
    load = sine((1, 2, 0.5), 0.7, frame="space")
    kernel, block, arrays, end = marched(INTEGRATORS[name](order=order), "heavy_top", load)
    memory = np.zeros(2**20)
    image, states = image_of(block, arrays, memory.ctypes.data)
    memory[: len(image) // 8] = np.frombuffer(image)
    assert memory.tobytes()[states] != end.tobytes()
    kernel.function(memory.ctypes.data)
    assert memory.tobytes()[states] == end.tobytes()


@pytest.mark.long
@pytest.mark.skipif(
    not (FUSED and shutil.which("qemu-aarch64")), reason="needs qemu-aarch64, and this processor an fma"
)
@pytest.mark.parametrize("load", [Load(), sine((1, 2, 0.5), 0.7), sine((1, 2, 0.5), 0.7, frame="space")], ids=str)
@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize(("name", "order"), CASES)
def test_aarch64_gives_the_same_bits(name, order, body, load, tmp_path):
    """In QEMU: a program calls the kernel on an image of its memory, at an address that is free on both machines."""
    if (name, body) == ("split", "suslov"):
        pytest.skip("split has no axes that are not principal")
    kernel, block, arrays, end = marched(INTEGRATORS[name](order=order), body, load)
    (image, states), found = image_of(block, arrays), []
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    (tmp_path / "harness.c").write_text(HARNESS.replace("PLACE", f"{AT}UL"), encoding="utf-8")
    for kind, emulator in (("x86_64", []), ("aarch64", ["qemu-aarch64"])):
        module, cpu = binding.parse_assembly(kernel.code()), "haswell" if kind == "x86_64" else "generic"
        module.triple = f"{kind}-unknown-linux-gnu"
        machine = binding.Target.from_triple(module.triple).create_target_machine(cpu=cpu, reloc="static")
        module.data_layout = str(machine.target_data)
        (tmp_path / "kernel.o").write_bytes(machine.emit_object(module))
        (tmp_path / "image").write_bytes(image)
        gcc = [f"{kind}-linux-gnu-gcc", "-static", "-no-pie", "harness.c", "kernel.o", "-lm", "-o", "harness"]
        for command in (gcc, [*emulator, "./harness", "image", str(len(image))]):
            subprocess.run(command, cwd=tmp_path, check=True)
        found.append((tmp_path / "image").read_bytes()[states])
    assert found[0] != image[states]  # the kernel has worked
    assert found[0] == found[1] == end.tobytes()
