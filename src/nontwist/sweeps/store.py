"""What a sweep leaves on disk: a Zarr group (version 3), one chunk of every variable for each block of members.

A block is done when its marker is there, ``blocks/000/000017.json``, written last and by the one client that holds the
lock: the SHA-256 of the block's bytes, and why members have failed. Chunks carry a CRC-32C. A block is written whole,
with the same bits whoever makes it, so that writing it twice does no harm. ``status`` is 0 for a member that is done,
−1 for one whose numbers make no run, −2 where nothing is yet; other numbers are those of `nontwist.Status`.
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

from ..analysis.trajectory import versions
from ..geometry.arrays import Array
from ..integrators import Status
from ..io.whole import whole, whole_folder
from .draws import values
from .members import REFUSED, SIZES, Members, Results

FORMAT, ABSENT = 1, -2
MOST_REASONS = 1000  # that a marker keeps; each member tells its own when it is run again
MISSING = "sweeps need Zarr and Dask, which are not installed: pip install zarr dask distributed"


class SweepStoreError(ValueError):
    """A folder that is no store of this sweep; the message says why in one line.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import SweepStoreError, open_sweep
    >>> Path("empty").mkdir()
    >>> try:
    ...     open_sweep("empty")
    ... except SweepStoreError as error:
    ...     print(error)
    empty is not the store of a sweep: it is no Zarr group with a folder blocks
    """


class Done(NamedTuple):
    """What the marker of a block says."""

    block: int
    sha256: str
    failed: int  #: members with a status other than 0
    reasons: dict[str, str]  #: why, by their numbers
    seconds: float


class Found(NamedTuple):
    """What a look at every byte of a store has found."""

    members: int
    blocks: int
    missing: tuple[int, ...]  #: blocks that are not done
    damaged: dict[int, str]  #: blocks whose bytes are not those that were written
    failed: int  #: members that have failed
    sha256: str | None  #: of all numbers in the order of members, whatever the blocks; None where some are not there

    @property
    def complete(self) -> bool:
        """Whether every member is there as it was written."""
        return not self.missing and not self.damaged


class SweepStore:
    """A store that is there; made by `create`, found by `open_store`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.group = _zarr().open_group(str(path), mode="r+")
        attributes: dict[str, Any] = dict(self.group.attrs)
        if attributes.get("sweep_format") != FORMAT:
            raise SweepStoreError(f"{path} is no sweep that this version of nontwist reads: it has no sweep_format 1")
        self.attributes = attributes
        self.block = int(attributes["block"])
        self.members = Members(attributes["run_file"], Path(attributes["folder"]))
        self.names = [*self.members.kept, "status"]

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-len(self.members) // self.block)

    def span(self, k: int) -> tuple[int, int]:
        """Return the first member of a block and the first of the next."""
        return k * self.block, min((k + 1) * self.block, len(self.members))

    def compute(self, k: int) -> Results:
        """Make a block."""
        return self.members.run(values(self.members.sweep, *self.span(k)))

    def write(self, k: int, results: Results) -> str:
        """Write a block without its marker and return its hash."""
        first, last = self.span(k)
        arrays: dict[str, Any] = {**results.arrays, "status": results.status}
        for name in self.names:
            self.group[name][first:last] = arrays[name]
        return _sha256(arrays[name] for name in self.names)

    def read(self, k: int) -> dict[str, Array]:
        """Return the arrays of a block; a ValueError where a checksum is wrong."""
        first, last = self.span(k)
        return {name: self.group[name][first:last] for name in self.names}

    def marker(self, k: int) -> Path:
        """Return where the marker of a block is."""
        return self.path / "blocks" / f"{k // 1000:03d}" / f"{k:06d}.json"

    def mark(self, done: Done) -> None:
        """Write the marker of a block."""
        place = self.marker(done.block)
        place.parent.mkdir(exist_ok=True)
        with whole(place) as file:
            file.write(json.dumps(done._asdict(), indent=1).encode())

    def done(self) -> dict[int, Done]:
        """Return what the markers say."""
        found = {}
        for k in range(self.blocks):
            try:
                found[k] = Done(**json.loads(self.marker(k).read_bytes()))
            except FileNotFoundError:
                continue
            except (ValueError, TypeError):  # a marker that was damaged counts for none
                continue
        return found

    def verified(self) -> Found:
        """Read every byte, hash it again, and count."""
        marked, names = self.done(), self.names
        damaged: dict[int, str] = {}
        whole_hash = {name: hashlib.sha256() for name in names}
        present = 0
        with ThreadPoolExecutor(1) as pool:  # reads one block ahead
            order, ahead = [*marked], [pool.submit(self._readable, k) for k in [*marked][:1]]
            for n, k in enumerate(order):
                arrays = ahead.pop().result()
                ahead = [pool.submit(self._readable, k) for k in order[n + 1 : n + 2]]
                if isinstance(arrays, str):
                    damaged[k] = arrays
                elif _sha256(arrays[name] for name in names) != marked[k].sha256:
                    gone = [name for name in names if not self._chunk(name, k).exists()]
                    damaged[k] = f"{', '.join(gone)} deleted" if gone else "its bytes are not those that were written"
                else:
                    present += 1
                    for name in names:
                        whole_hash[name].update(arrays[name].tobytes())
        missing = tuple(k for k in range(self.blocks) if k not in marked)
        failed = sum(done.failed for k, done in marked.items() if k not in damaged)
        total = None
        if present == self.blocks:
            total = _sha256(np.frombuffer(whole_hash[name].digest(), np.uint8) for name in names)
        return Found(len(self.members), self.blocks, missing, damaged, failed, total)

    def _readable(self, k: int) -> dict[str, Array] | str:
        try:
            return self.read(k)
        except Exception as error:  # zarr and its codecs raise what they like
            return f"{type(error).__name__}: {error}"

    def _chunk(self, name: str, k: int) -> Path:
        array = self.group[name]
        key: str = array.metadata.chunk_key_encoding.encode_chunk_key((k, *[0] * (array.ndim - 1)))
        return self.path / name / key

    def clear(self, blocks: Iterable[int]) -> None:
        """Take the markers of blocks away, and what killed writers have left."""
        for k in blocks:
            self.marker(k).unlink(missing_ok=True)
        for left in self.path.glob("**/*.partial"):
            left.unlink(missing_ok=True)


def open_store(path: str | os.PathLike[str]) -> SweepStore:
    """Return the store in a folder.

    Raises
    ------
    SweepStoreError
        The folder holds no sweep.
    FileNotFoundError
        There is no such folder.
    """
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such store: {path}")
    place = Path(os.path.realpath(path))
    if not (place / "zarr.json").is_file() or not (place / "blocks").is_dir():
        raise SweepStoreError(f"{path} is not the store of a sweep: it is no Zarr group with a folder blocks")
    return SweepStore(place)


def create(path: Path, members: Members, block: int) -> SweepStore:
    """Make an empty store; it appears under its name when all of it is there."""
    with whole_folder(path) as temporary:
        _fill(temporary, members, block)
    return SweepStore(path)


def _fill(temporary: Path, members: Members, block: int) -> None:
    zarr = _zarr()
    group = zarr.create_group(str(temporary), attributes=_record(members, block))
    statuses = [ABSENT, REFUSED, *map(int, Status)]
    meanings = ["absent", "refused", *(status.name.lower() for status in Status)]
    m = len(members)
    for name, kept in members.kept.items():
        shape = tuple(SIZES[dim] for dim in kept.dims)
        _array(group, name, (m, *shape), block, np.float64, np.nan, kept.dims, kept.attributes)
    flags = {
        "long_name": "how the run of the member ended",
        "flag_values": statuses,
        "flag_meanings": " ".join(meanings),
    }
    _array(group, "status", (m,), block, np.int8, ABSENT, (), flags)
    group.create_group("blocks")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that other readers may not know consolidated metadata; they need not
        zarr.consolidate_metadata(str(temporary))


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
        config={"write_empty_chunks": True},
    )


def _record(members: Members, block: int) -> dict[str, Any]:
    return {
        "sweep_format": FORMAT,
        "title": members.file.title or f"{len(members)} {members.file.body.kind} rigid bodies",
        "run_file": members.text,
        "run_file_sha256": hashlib.sha256(members.text.encode()).hexdigest(),
        "folder": str(members.folder.absolute()),
        "block": block,
        "t_end": members.file.time.t_end,
        "conventions": "Λ maps body to space; quaternions have the scalar last; NaN stands in what failed members have "
        "not reached",
        "versions": json.dumps(versions()),
    }


def _sha256(arrays: Iterable[Array]) -> str:
    total = hashlib.sha256()
    for array in arrays:
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def _zarr() -> Any:
    try:
        import zarr
    except ImportError as error:
        raise ImportError(MISSING) from error
    return zarr
