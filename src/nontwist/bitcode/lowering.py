"""From a kernel to bitcode for a named target, through Numba and LLVM.

Numba lowers a kernel, with all that it calls, to a module of LLVM that nobody has optimised yet: it knows no processor.
This module is given a function of one address with the calling convention of C, is told its target, and is optimised
for that once. What is left for the run is to generate code, which `geometry.machine_code` does.

Kernels are lowered without Numba's run time, so that one that allocates memory is refused here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from struct import iter_unpack
from typing import Any

from ..geometry.compiled import Kernel, nested, numba
from ..geometry.elements import doubles, integers, viewed
from ..geometry.machine_code import ENTRY
from ..kernels.signatures import Signature

TARGETS = {
    "x86-64-v3": ("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "aarch64": ("aarch64-unknown-linux-gnu", "generic"),
}
UNDEFINED, GLOBAL = 0, 1  # section of a symbol of an object file, and its binding


def lowered(kernel: Kernel) -> Any:
    """Return the module of LLVM of a kernel, not optimised: it defines the C function `ENTRY` alone."""
    from llvmlite import binding, ir

    compiler: Any = numba()
    core, signature = compiler.core, kernel.signature
    assert signature is not None
    function = kernel.py_func if signature.is_address else entry(kernel, signature)
    how = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": nested(), "_nrt": False}
    dispatcher = compiler.njit(nogil=True, error_model="numpy", **how)(function)
    types = (compiler.types.int64,)
    dispatcher.compile(types)
    made = dispatcher.overloads[types]
    context = core.registry.cpu_target.target_context
    whole = context.codegen()._create_empty_module(ENTRY)
    outer = ir.Function(whole, ir.FunctionType(ir.VoidType(), [ir.IntType(64)]), ENTRY)
    builder = ir.IRBuilder(outer.append_basic_block())
    inner = context.declare_function(whole, made.fndesc)
    context.call_conv.call_function(builder, inner, made.fndesc.restype, types, outer.args)
    builder.ret_void()
    module = binding.parse_assembly(str(whole))
    module.link_in(made.library._get_module_for_linking(), preserve=True)
    for number, value in enumerate([*module.functions, *module.global_variables]):
        if value.name != ENTRY and not value.is_declaration:
            value.linkage = "internal"
            value.name = f"_{number}"
    return module


def entry(kernel: Kernel, signature: Signature) -> Callable[[int], None]:
    """Return a function of the address of what `Signature.pack` lays out, which calls a kernel with arrays.

    It is Python for Numba alone: arrays are views of the memory at their addresses.
    """
    lines, names = [], []
    for number, (kind, place, axes) in enumerate(signature.places):
        numbers = "r" if kind == "f8" else "b"
        names.append(name := f"x{number}")
        if not axes:
            lines.append(f"{name} = {numbers}[{place}]")
            continue
        shape = "".join(f"b[{place + 1 + axis}], " for axis in range(axes))
        lines.append(f"{name} = viewed({'doubles' if kind == 'f8' else 'integers'}(b[{place}]), ({shape}))")
    results = [f"{'r' if kind == 'f8' else 'b'}[{place}]" for kind, place, _ in signature.results]
    lines.append(f"{', '.join(results) + ' = ' if results else ''}kernel({', '.join(names)})")
    text = "def entry(address):\n    b, r = integers(address), doubles(address)\n    " + "\n    ".join(lines)
    known: dict[str, Any] = {"kernel": kernel, "viewed": viewed, "doubles": doubles, "integers": integers}
    exec(compile(text, f"<entry of {kernel.name}>", "exec"), known)
    made: Callable[[int], None] = known["entry"]
    return made


def bitcode(module: Any, target: str, unroll: bool, vectorize: bool = False) -> tuple[bytes, list[str]]:
    """Return bitcode of a module that is lowered, optimised for a target, and the symbols that its code asks for.

    Loops are not vectorised unless a kernel asks for it: what else gains by vectors is written in them. That makes less
    code, at equal speed.
    """
    from llvmlite import binding

    machine, quick, layout = _machines(target)
    module = module.clone()
    module.triple, module.data_layout = TARGETS[target][0], layout
    options = binding.create_pipeline_tuning_options(3)
    options.loop_unrolling, options.loop_vectorization, options.slp_vectorization = unroll, vectorize, False
    passes = binding.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    module.verify()
    _drop_names(module)
    return module.as_bitcode(), undefined(quick.emit_object(module))


def _drop_names(module: Any) -> None:
    """Take the names off all values, which are half of the bitcode."""
    for function in module.functions:
        for value in function.arguments if not function.is_declaration else ():
            value.name = ""
        for block in function.blocks:
            block.name = ""
            for value in block.instructions:
                if value.name:
                    value.name = ""


@lru_cache
def _machines(target: str) -> tuple[Any, Any, str]:
    """Return what optimises for a target, what makes code in a fraction of the time, and the layout of its data."""
    from llvmlite import binding

    numba()
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    triple, processor = TARGETS[target]
    found = binding.Target.from_triple(triple)
    machine, quick = (found.create_target_machine(cpu=processor, opt=opt, codemodel="default") for opt in (3, 0))
    return machine, quick, str(machine.target_data)


def undefined(elf: bytes) -> list[str]:
    """Return the symbols that an object file of ELF does not define."""
    from llvmlite import binding

    sections = {section.name(): section.data() for section in binding.ObjectFileRef.from_data(elf).sections()}
    names, found = sections[b".strtab"], set()
    for name, about, _, section, _, _ in iter_unpack("<IBBHQQ", sections[b".symtab"]):
        if section == UNDEFINED and about >> 4 >= GLOBAL:
            found.add(names[name : names.index(b"\0", name)].decode())
    return sorted(found)
