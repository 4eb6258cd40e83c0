"""``python -m nontwist.bitcode``: make the bitcode of all kernels, as far as it is missing or stale."""

from .building import build

if __name__ == "__main__":
    build()
