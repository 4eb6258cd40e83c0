"""Texts on a GPU of NVIDIA: PTX by LLVM, and the library of the driver, by ctypes.

Functions. NVPTX has roots, fused multiply-adds and roundings, and no other function: those of `elementary` are traced.

Contraction. LLVM contracts nothing that is not marked, and nothing is: it writes ``mul.rn`` and ``add.rn``, which the
assembler in the driver has to leave apart, and ``fma.rn`` where a text says `fma`. So what calls none of these
functions has the bits that it has on a processor with a fused multiply-add.

A thread runs a text on one lane. What it has for itself is on its stack, which a GPU keeps in columns: the same number
of neighbouring threads side by side.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from ..errors import SENTENCES, InputError
from . import machine_code
from .control import when
from .elementary import OWN
from .elements import LITERALS, Whole
from .kernel import part
from .machine_code import TraceError, Tracer, tracing

SENTENCES |= {
    "no-gpu": "{option[device='gpu']}: there is no GPU of NVIDIA that can be used here ({why}); leave it out",
    "gpu-failed": "the GPU has failed, {call}: {why}; take fewer members at a time, or leave {option[device]} out",
    "not-on-gpu": "{what} does not run on a GPU{but}; leave {option[device]} out",
}


MEMBER, ENTRY, THREADS = "member", "march", 64  # functions of a module; threads of a block
LAUNCH = f"""
define ptx_kernel void @{ENTRY}(i64 %a0, i64 %count) {{
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %size = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %before = mul i32 %block, %size
  %index = add i32 %before, %thread
  %number = zext i32 %index to i64
  %is_there = icmp ult i64 %number, %count
  br i1 %is_there, label %do, label %done
do:
  call void @{MEMBER}(i64 %a0, i64 %number)
  br label %done
done:
  ret void
}}
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
"""
Texts = Mapping[tuple[int, int], Callable[..., Any]]  # by the number of arguments, and the address on the processor


class GpuTracer(Tracer):
    """A module of LLVM in the making for threads of a GPU; functions at addresses are traced where they are called."""

    has_vectors = False

    def __init__(self, texts: Texts) -> None:
        super().__init__(1, True)
        self.texts = texts

    def in_place_of(self, name: str) -> Callable[..., Any]:
        """Return the text of a function of C."""
        if name not in OWN:
            raise TraceError(f"a GPU has no {name} here, but {', '.join(OWN)} and sqrt")
        return OWN[name]

    def traces(self, function: Any, arguments: tuple[Any, ...]) -> bool:
        """Trace the functions of so many arguments, whichever is at an address."""
        for (count, address), text in self.texts.items():
            for _ in when(function == address) if count == len(arguments) else ():
                part(text)(*arguments)
        return True

    def table(self, array: Any) -> str:
        """Return the address of an array that is part of the code."""
        name, numbers = f"@table{self.number()}", [f"double {LITERALS['double'](x)}" for x in array.ravel().tolist()]
        kind = f"[{len(numbers)} x double]"
        self._functions.append(f"{name} = internal addrspace(1) constant {kind} [{', '.join(numbers)}]")
        return f"ptrtoint (ptr addrspacecast (ptr addrspace(1) {name} to ptr) to i64)"


def code_of(text: Callable[[Any, Any], None], texts: Texts) -> str:
    """Return LLVM's code of a text of an address and the number of a member; `texts` are those that it calls."""
    t = GpuTracer(texts)
    with tracing(t):
        t.open(MEMBER, "i64 %a0, i64 %a1", True)
        text(Whole("%a0"), Whole("%a1"))
        t.line("ret void")
        t.close()
    return t.text + LAUNCH


@cache
def ptx_of(code: str) -> str:
    """Return the PTX of LLVM's code, for Volta and what came after it."""
    with machine_code.LOCK:
        llvm = machine_code.binding()
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        target = llvm.Target.from_triple("nvptx64-nvidia-cuda").create_target_machine(cpu="sm_70", opt=3)
        module = llvm.parse_assembly(code)
        machine_code.simplify(module, target)
        return target.emit_assembly(module)


class Gpu:
    """The first GPU, by the library of its driver.

    Raises
    ------
    InputError
        no-gpu: there is none; gpu-failed: a call of the driver fails.
    """

    def __init__(self) -> None:
        try:
            self._driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        except OSError as error:
            raise InputError("no-gpu", why=f"the library of its driver is not found: {error}") from None
        device, self._context = ctypes.c_int(), ctypes.c_void_p()
        self._functions: dict[str, ctypes.c_void_p] = {}
        try:
            self._call("cuInit", 0)
            self._call("cuDeviceGet", ctypes.byref(device), 0)
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), device)
        except InputError as error:
            raise InputError("no-gpu", why="{call}: {why}".format(**error.fields)) from None

    def _call(self, name: str, *arguments: Any) -> None:
        """Call the driver."""
        if (status := getattr(self._driver, name)(*arguments)) != 0:
            text = ctypes.c_char_p()
            self._driver.cuGetErrorString(status, ctypes.byref(text))
            raise InputError("gpu-failed", call=name, why=(text.value or b"").decode() or f"error {status}")

    def use(self) -> None:
        """Let this thread use the GPU."""
        self._call("cuCtxSetCurrent", self._context)

    def copy(self, array: Any) -> int:
        """Return the address of a copy of an array on the GPU, until `free`."""
        found = ctypes.c_uint64()
        self._call("cuMemAlloc_v2", ctypes.byref(found), ctypes.c_size_t(max(array.nbytes, 1)))
        self._call("cuMemcpyHtoD_v2", found, ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes))
        return found.value

    def take(self, address: int, array: Any) -> None:
        """Copy what lies at an address of the GPU to an array."""
        source, size = ctypes.c_uint64(address), ctypes.c_size_t(array.nbytes)
        self._call("cuMemcpyDtoH_v2", ctypes.c_void_p(array.ctypes.data), source, size)

    def free(self, address: int) -> None:
        """Give the memory of a copy back; where that fails, a call before has failed already."""
        self._driver.cuMemFree_v2(ctypes.c_uint64(address))

    def run(self, code: str, address: int, count: int) -> None:
        """Run LLVM's code with an address for so many members, and wait for them."""
        if code not in self._functions:
            module, function, ptx = ctypes.c_void_p(), ctypes.c_void_p(), ptx_of(code).encode()
            self._call("cuModuleLoadDataEx", ctypes.byref(module), ctypes.c_char_p(ptx), 0, None, None)
            self._call("cuModuleGetFunction", ctypes.byref(function), module, ENTRY.encode())
            self._functions[code] = function
        given = ctypes.c_uint64(address), ctypes.c_uint64(count)
        pointers = (ctypes.c_void_p * 2)(*map(ctypes.addressof, given))
        shape = -(-count // THREADS), 1, 1, THREADS, 1, 1
        self._call("cuLaunchKernel", self._functions[code], *shape, 0, None, pointers, None)
        self._call("cuCtxSynchronize")


@cache
def gpu() -> Gpu:
    """Return the first GPU."""
    return Gpu()
