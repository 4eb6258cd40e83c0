"""The store of a sweep: a Zarr group (version 3), one chunk of every variable for each block of members.

A block is done when its marker is there, ``blocks/000/000017.json``, written last and by the one client that holds the
lock: hashes of the block, and why members have failed (`seals`). Chunks carry a CRC-32C. A block is written whole,
with the same bits by any worker, so that it may be written twice. ``status`` is 0 for a member that is done,
−1 for one whose numbers define no run, −2 for one that is not done; others are those of `nontwist.errors.Status`.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..analysis.ensemble_dataset import status_attributes
from ..analysis.trajectory import versions
from ..analysis.variables import SIZES
from ..errors import SweepStoreError
from ..geometry.arrays import Array
from ..geometry.values import as_path
from ..integrators import Status
from ..io.whole import atomic_folder
from .draws import values
from .members import REFUSED, Members, Results
from .seals import CHANGED, SEAL, DamagedBlockError, Done, Marks, damaged, read_seal, write_seal

FORMAT, ABSENT = 2, -2
MOST_REASONS = 1000  # in a marker; running a member again gives its own
MISSING = "sweeps need Zarr and Dask, which are not installed: pip install zarr dask distributed"


class Verification(NamedTuple):
    """The result of reading and hashing every byte of a store."""

    members: int
    blocks: int
    missing: tuple[int, ...]  #: blocks that are not done
    damaged: dict[int, str]  #: blocks that were changed, and why
    failed: int  #: members that have failed
    sha256: str | None  #: of all numbers in the order of members, whatever the blocks; None where some are not there

    @property
    def complete(self) -> bool:
        """Whether every member is stored as it was written."""
        return not self.missing and not self.damaged


class SweepStore:
    """An existing store; made by `create`, opened by `open_store`."""

    def __init__(self, path: Path, verify: bool = True, members: Members | None = None) -> None:
        zarr = _zarr()
        self.path, seal = path, read_seal(path) if verify else None
        self.files: Any = zarr.storage.LocalStore(path)
        try:
            attributes: dict[str, Any] = dict(zarr.open_group(self.files, mode="r+", zarr_format=3).attrs)
            form, self.block = attributes["sweep_format"], int(attributes["block"])
            text, folder = str(attributes["run_file"]), Path(attributes["folder"])
            if self.block < 1:
                raise ValueError(f"block {self.block}")
            changed = hashlib.sha256(text.encode()).hexdigest() != attributes["run_file_sha256"]
        except Exception as error:  # Zarr raises exceptions of any kind
            raise SweepStoreError(f"{path} is not the store of a sweep, or is damaged: {_words(error)}") from error
        if form != FORMAT:
            raise SweepStoreError(f"{path} has sweep_format {form}; this version of nontwist reads {FORMAT}")
        if verify and seal is None:
            raise damaged(path, f"{SEAL} is missing")
        if verify and changed:
            raise damaged(path, f"its run file {CHANGED}")
        self.attributes = attributes
        known = members is not None and (members.text, members.folder.path.absolute()) == (text, folder)
        self.members = members if members is not None and known else Members.of(text, folder)
        self.names = [*self.members.kept, "status"]
        self.marks = Marks(path, self.block, len(self.members), seal)
        if seal is not None:
            from .sealed_files import SealedFiles

            self.files = SealedFiles(self.files, seal, self.marks, self.marks.present())
        self.group = zarr.open_group(self.files, mode="r+", zarr_format=3)

    @property
    def seal(self) -> str:
        """The hash of the seal; "" where it is not verified."""
        return "" if self.marks.seal is None else self.marks.seal.sha256

    @property
    def seal_words(self) -> str:
        """The hash of the seal, or why there is none."""
        return self.seal or "not read: verify=False"

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return self.marks.blocks

    def span(self, k: int) -> tuple[int, int]:
        """Return the first member of a block and the first of the next."""
        return self.marks.span(k)

    def compute(self, k: int) -> Results:
        """Compute a block."""
        return self.members.run(values(self.members.sweep, *self.span(k)))

    def write(self, k: int, results: Results) -> tuple[str, dict[str, str | None]]:
        """Write a block without its marker; return the hash of its numbers, and those of its files."""
        first, last = self.span(k)
        arrays: dict[str, Any] = {**results.arrays, "status": results.status}
        self.files.present[k] = 0
        for name in self.names:
            self.group[name][first:last] = arrays[name]
        chunks = {name: self.files.hashes.pop(self._key(name, k), None) for name in self.names}
        return _sha256(arrays[name] for name in self.names), chunks

    def read(self, k: int) -> dict[str, Array]:
        """Return the arrays of a block; a ValueError where they were changed."""
        first, last = self.span(k)
        return {name: self.group[name][first:last] for name in self.names}

    def done(self) -> dict[int, Done]:
        """Return the markers; a DamagedBlockError where one was changed."""
        return {k: self.marks.read(k) for k, there in enumerate(self.marks.present()) if there}

    def verified(self) -> Verification:
        """Read every byte, hash it again, and count."""
        present = self.marks.present()
        if self.seal:
            self.files.present[:] = present
        faults: dict[int, str] = {}
        whole_hash = {name: hashlib.sha256() for name in self.names}
        good = failed = 0
        with ThreadPoolExecutor(1) as pool:  # reads one block ahead
            order = [k for k in range(self.blocks) if present[k]]
            ahead = [pool.submit(self._sound, k) for k in order[:1]]
            for n, k in enumerate(order):
                found = ahead.pop().result()
                ahead = [pool.submit(self._sound, k) for k in order[n + 1 : n + 2]]
                if isinstance(found, str):
                    faults[k] = found
                    continue
                good, failed = good + 1, failed + found[0].failed
                for name in self.names:
                    whole_hash[name].update(found[1][name].tobytes())
        missing = tuple(k for k in range(self.blocks) if not present[k])
        total = None
        if good == self.blocks:
            total = _sha256(np.frombuffer(whole_hash[name].digest(), np.uint8) for name in self.names)
        return Verification(len(self.members), self.blocks, missing, faults, failed, total)

    def _sound(self, k: int) -> tuple[Done, dict[str, Array]] | str:
        """Return the marker and the arrays of a block, or why they differ from what was written."""
        try:
            done, arrays = self.marks.read(k), self.read(k)
        except DamagedBlockError as error:
            return error.reason
        except Exception as error:  # Zarr and its codecs raise exceptions of any kind
            return _words(error)
        if _sha256(arrays[name] for name in self.names) == done.sha256:
            return done, arrays
        missing = [name for name in self.names if not self._chunk(name, k).exists()]
        return f"{', '.join(missing)} is missing" if missing else f"it {CHANGED}"

    def _chunk(self, name: str, k: int) -> Path:
        return self.path / self._key(name, k)

    def _key(self, name: str, k: int) -> str:
        array = self.group[name]
        key: str = array.metadata.chunk_key_encoding.encode_chunk_key((k, *[0] * (array.ndim - 1)))
        return f"{name}/{key}"

    def clear(self, blocks: Iterable[int]) -> None:
        """Remove the markers of blocks, and temporary files of killed writers."""
        for k in blocks:
            self.marks.place(k).unlink(missing_ok=True)
        for left in self.path.glob("**/*.partial"):
            left.unlink(missing_ok=True)


def open_store(path: str | os.PathLike[str], verify: bool = True, members: Members | None = None) -> SweepStore:
    """Return the store in a folder; with `verify`, its metadata compared with their seal.

    Its file is not read again where it is that of `members`.

    Raises
    ------
    SweepStoreError
        The folder holds no sweep, or one whose metadata are damaged.
    FileNotFoundError
        There is no such folder.
    """
    path = as_path(path, "store")
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such store: {path}")
    place = Path(os.path.realpath(path))
    if not (place / "zarr.json").is_file() or not (place / "blocks").is_dir():
        raise SweepStoreError(f"{path} is not the store of a sweep: it is not a Zarr group with a folder blocks")
    return SweepStore(place, verify, members)


def create(path: Path, members: Members, block: int) -> SweepStore:
    """Make an empty store; it appears under its name when it is complete."""
    with atomic_folder(path) as temporary:
        _fill(temporary, members, block)
    return SweepStore(path, members=members)


def _fill(temporary: Path, members: Members, block: int) -> None:
    zarr = _zarr()
    group = zarr.create_group(str(temporary), attributes=_record(members, block))
    statuses = {ABSENT: "absent", REFUSED: "refused", **{int(status): status.name.lower() for status in Status}}
    m = len(members)
    for name, kept in members.kept.items():
        shape = tuple(SIZES[dim] for dim in kept.dims)
        _array(group, name, (m, *shape), block, np.float64, np.nan, kept.dims, kept.attributes)
    _array(group, "status", (m,), block, np.int8, ABSENT, (), status_attributes(statuses))
    group.create_group("blocks")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that other readers may not know consolidated metadata; they need not
        zarr.consolidate_metadata(str(temporary))
    write_seal(temporary)


def _array(
    group: Any, name: str, shape: tuple[int, ...], block: int, dtype: Any, fill: Any, dims: Any, attributes: Any
) -> None:
    from zarr.codecs import Crc32cCodec

    group.create_array(
        name,
        shape=shape,
        chunks=(block, *shape[1:]),
        dtype=dtype,
        fill_value=fill,
        compressors=Crc32cCodec(),
        chunk_key_encoding={"name": "default", "separator": "."},
        dimension_names=("member", *dims),
        attributes=attributes,
    )


def _record(members: Members, block: int) -> dict[str, Any]:
    return {
        "sweep_format": FORMAT,
        "title": members.file.title or f"{len(members)} {members.file.body.kind} rigid bodies",
        "run_file": members.text,
        "run_file_sha256": hashlib.sha256(members.text.encode()).hexdigest(),
        "folder": str(members.folder.path.absolute()),
        "block": block,
        "t_end": members.file.time.t_end,
        "conventions": "Λ maps body to space; quaternions have the scalar last; what failed members have "
        "not reached is NaN",
        "versions": json.dumps(versions()),
    }


def _sha256(arrays: Iterable[Array]) -> str:
    total = hashlib.sha256()
    for array in arrays:
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _zarr() -> Any:
    try:
        import zarr
    except ImportError as error:
        raise ImportError(MISSING) from error
    return zarr
