"""The kernels as LLVM bitcode: made here when the package is built, read by `geometry.machine_code` when it runs."""
