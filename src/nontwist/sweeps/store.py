"""The store of a sweep: a Zarr group (version 3), one chunk of every variable for each block of members, sealed.

A block is done when its marker is there, ``blocks/000/000017.json``, written last and by the one client that holds the
lock. It holds the number of the block, the SHA-256 of the numbers of each variable as they were computed, and why
members have failed. ``blocks/seal.json``, written when the store is made, has the SHA-256 of each ``zarr.json``, and
markers repeat the hash of this seal, so that a block of another store is recognised. Seal and markers carry a hash of
their own text. So a changed file is noticed whichever it is, and so are chunks that are missing or exchanged, which
Zarr's own CRC-32C does not notice. Nothing here is a signature: who can write a store can seal it again.

A block is written whole, with the same bits by any worker, so that it may be written twice. ``status`` is 0 for a
member that is done, −1 for one whose numbers define no run, −2 for one that is not done; others are those of
`nontwist.errors.Status`.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..analysis.statistics import status_attributes
from ..analysis.trajectory import versions
from ..errors import SweepStoreError
from ..geometry.arrays import Array
from ..geometry.values import as_path
from ..integrators import Status
from ..io.whole import atomic_file, atomic_path
from ..machine import library
from ..runfile.document import file_of_text
from .members import REFUSED, Members, values

FORMAT, ABSENT = 3, -2
SEAL = "blocks/seal.json"  # where readers of Zarr do not look for arrays
CONVENTIONS = "Λ maps body to space; quaternions have the scalar last; what failed members have not reached is NaN"
CHANGED = "was changed after it was written"
MOST_REASONS = 1000  # in a marker; running a member again gives its own
MISSING = "sweeps need Zarr and Dask, which are not installed: pip install zarr dask distributed"


class DamagedBlockError(SweepStoreError):
    """A block that was changed after it was written: `where` it is, and the `reason`."""

    def __init__(self, where: str, reason: str) -> None:
        super().__init__(where, reason)
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.args[0]}: {self.reason}; run the sweep again to recompute the block"


class Done(NamedTuple):
    """The marker of a block."""

    block: int
    failed: int  #: members with a status other than 0
    reasons: dict[str, str]  #: why, by their numbers
    seconds: float
    sha256: dict[str, str]  #: of the numbers of each variable


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


def sealed(data: dict[str, Any]) -> bytes:
    """Return JSON text that holds its own hash under the key "seal"."""
    own = hashlib.sha256(json.dumps(data, indent=1).encode()).hexdigest()
    return json.dumps({**data, "seal": own}, indent=1).encode()


def unsealed(text: bytes) -> dict[str, Any]:
    """Return the data of `sealed`; a ValueError where the text was changed."""
    try:
        data = json.loads(text)
    except RecursionError as error:
        raise ValueError(CHANGED) from error
    if not isinstance(data, dict) or sealed({key: value for key, value in data.items() if key != "seal"}) != text:
        raise ValueError(CHANGED)
    return data


def _verified_seal(path: Path) -> str:
    """Return the hash of the seal of a store; a SweepStoreError where it, or a file of metadata, is damaged."""
    name = SEAL
    try:
        seal = unsealed((path / SEAL).read_bytes())
        for name, expected in dict(seal["files"]).items():
            if hashlib.sha256((path / name).read_bytes()).hexdigest() != expected:
                raise ValueError(CHANGED)
    except FileNotFoundError as error:
        raise _damaged(path, f"{name} is missing") from error
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, f"{name} {CHANGED}") from error
    return str(seal["seal"])


def _damaged(path: Path, reason: str) -> SweepStoreError:
    remedy = "run the sweep into a new store, or read this one unchecked with open_sweep(..., verify=False)"
    return SweepStoreError(f"{path} is damaged: {reason}; {remedy}")


class Blocks:
    """The blocks of a store: their markers, and their numbers as Zarr's `group` has them.

    Parameters
    ----------
    path : Path
        The store.
    group : zarr.Group
    block, members : int
        Members of a block, and of the sweep.
    seal : str
        Its hash; "" where nothing is verified.
    """

    def __init__(self, path: Path, group: Any, block: int, members: int, seal: str) -> None:
        self.path, self.group, self.block, self.members, self.seal = path, group, block, members, seal

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return -(-self.members // self.block)

    def span(self, k: int) -> tuple[int, int]:
        """Return the first member of a block and the first of the next."""
        return k * self.block, min((k + 1) * self.block, self.members)

    def name(self, k: int) -> str:
        """Return a block in words."""
        first, last = self.span(k)
        return f"block {k}, members {first} to {last - 1}"

    def place(self, k: int) -> Path:
        """Return where the marker of a block is."""
        return self.path / "blocks" / f"{k // 1000:03d}" / f"{k:06d}.json"

    def chunk(self, name: str, k: int) -> Path:
        """Return where the numbers of a variable are."""
        array = self.group[name]
        key: str = array.metadata.chunk_key_encoding.encode_chunk_key((k, *[0] * (array.ndim - 1)))
        return self.path / name / key

    def present(self) -> bytearray:
        """Return for each block whether it has a marker, 0 or 1; no marker is read."""
        found = bytearray(self.count)
        for first in range(0, self.count, 1000):
            folder = self.place(first).parent
            names = set(os.listdir(folder)) if folder.is_dir() else set()
            for k in range(first, min(first + 1000, self.count)):
                found[k] = self.place(k).name in names
        return found

    def mark(self, done: Done) -> None:
        """Mark a block as done."""
        place = self.place(done.block)
        place.parent.mkdir(exist_ok=True)
        with atomic_file(place) as file:
            file.write(sealed({**done._asdict(), "store": self.seal}))

    def marker(self, k: int) -> Done:
        """Return the marker of a block.

        Raises
        ------
        DamagedBlockError
            The marker is missing or damaged, or is that of another block or store.
        """
        try:
            text = self.place(k).read_bytes()
            data = unsealed(text) if self.seal else json.loads(text)
            done = Done(**{name: data[name] for name in Done._fields})
        except FileNotFoundError as error:
            raise self.damaged(k, "its marker was removed after the store was opened") from error
        except (ValueError, TypeError, KeyError) as error:
            raise self.damaged(k, f"its marker {CHANGED}") from error
        if self.seal and data.get("store") != self.seal:
            raise self.damaged(k, "it belongs to another store")
        if done.block != k:
            raise self.damaged(k, f"block {done.block} is in its place")
        return done

    def array(self, name: str, k: int, done: Done | None = None) -> Array:
        """Return the numbers of a variable in a block; a DamagedBlockError where they are not those of its marker."""
        numbers: Any = slice(*self.span(k))
        if not self.seal:
            return np.asarray(self.group[name][numbers])
        done, cause = self.marker(k) if done is None else done, None
        try:
            found: Array = self.group[name][numbers]
            if _sha256(found) == done.sha256[name]:
                return found
        except MemoryError:
            raise
        except Exception as error:  # Zarr and its codecs raise exceptions of any kind
            cause = error
        raise self.damaged(k, f"{name} {CHANGED if self.chunk(name, k).is_file() else 'is missing'}") from cause

    def damaged(self, k: int, reason: str) -> DamagedBlockError:
        """Return the error that names a block and the reason."""
        return DamagedBlockError(f"{self.path}: {self.name(k)}", reason)


class SweepStore:
    """An existing store; made by `create`, opened by `open_store`."""

    def __init__(self, path: Path, verify: bool = True, members: Members | None = None) -> None:
        zarr, missing = library("zarr", MISSING), verify and not (path / SEAL).exists()
        seal = _verified_seal(path) if verify and not missing else ""
        try:
            self.group = zarr.open_group(path, mode="r+", zarr_format=3)
            self.attributes: dict[str, Any] = dict(self.group.attrs)
            form, block = self.attributes["sweep_format"], int(self.attributes["block"])
            text, folder = str(self.attributes["run_file"]), Path(self.attributes["folder"])
            if block < 1:
                raise ValueError(f"block {block}")
        except Exception as error:  # Zarr raises exceptions of any kind
            words = f"{type(error).__name__}: {error}"
            raise SweepStoreError(f"{path} is not the store of a sweep, or is damaged: {words}") from error
        if form != FORMAT:
            raise SweepStoreError(f"{path} has sweep_format {form}; this version of nontwist reads {FORMAT}")
        if missing:
            raise _damaged(path, f"{SEAL} is missing")
        known = members is not None and (members.text, members.folder.path.absolute()) == (text, folder)
        self.members = members if members is not None and known else Members(file_of_text("the sweep", text, folder))
        self.names = [*self.members.kept, "status"]
        self.blocks = Blocks(path, self.group, block, len(self.members), seal)

    @property
    def seal_words(self) -> str:
        """The hash of the seal, or why there is none."""
        return self.blocks.seal or "not read: verify=False"

    def make(self, k: int) -> Done:
        """Compute a block and write it, without its marker, which is returned."""
        begin, (first, last) = perf_counter(), self.blocks.span(k)
        results = self.members.run(values(self.members.sweep, first, last))
        arrays: dict[str, Any] = {**results.arrays, "status": results.status}
        for name in self.names:
            self.group[name][first:last] = arrays[name]
        reasons = {str(first + i): reason for i, reason in sorted(results.reasons.items())[:MOST_REASONS]}
        hashes = {name: _sha256(arrays[name]) for name in self.names}
        return Done(k, int(np.count_nonzero(results.status)), reasons, perf_counter() - begin, hashes)

    def done(self) -> dict[int, Done]:
        """Return the markers; a DamagedBlockError where one was changed."""
        return {k: self.blocks.marker(k) for k, there in enumerate(self.blocks.present()) if there}

    def verified(self) -> Verification:
        """Read every byte, hash it again, and count."""
        present, faults, failed = self.blocks.present(), dict[int, str](), 0
        whole = [hashlib.sha256() for _ in self.names]
        for k, there in enumerate(present):
            if not there:
                continue
            try:
                done = self.blocks.marker(k)
                arrays = [self.blocks.array(name, k, done) for name in self.names]
            except DamagedBlockError as error:
                faults[k] = error.reason
                continue
            failed += done.failed
            for one, array in zip(whole, arrays, strict=True):
                one.update(np.ascontiguousarray(array).data)
        missing = tuple(k for k, there in enumerate(present) if not there)
        total = hashlib.sha256(b"".join(one.digest() for one in whole)).hexdigest()
        counted = len(self.members), len(present), missing, faults, failed
        return Verification(*counted, None if missing or faults else total)

    def clear(self, blocks: Iterable[int]) -> None:
        """Remove the markers of blocks, and temporary files of killed writers."""
        for k in blocks:
            self.blocks.place(k).unlink(missing_ok=True)
        for left in self.blocks.path.glob("**/*.partial"):
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
    path = as_path(path, "path")
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such store: {path}")
    place = Path(os.path.realpath(path))
    if not (place / "zarr.json").is_file() or not (place / "blocks").is_dir():
        raise SweepStoreError(f"{path} is not the store of a sweep: it is not a Zarr group with a folder blocks")
    return SweepStore(place, verify, members)


def create(path: Path, members: Members, block: int) -> SweepStore:
    """Make an empty store; it appears under its name when it is complete."""
    zarr, m = library("zarr", MISSING), len(members)
    statuses = {ABSENT: "absent", REFUSED: "refused", **{int(status): status.name.lower() for status in Status}}
    with atomic_path(path) as temporary:
        record = {
            "sweep_format": FORMAT,
            "title": members.file.title or f"{m} {members.file.body.kind} rigid bodies",
            "run_file": members.text,
            "run_file_sha256": hashlib.sha256(members.text.encode()).hexdigest(),
            "folder": str(members.folder.path.absolute()),
            "block": block,
            "t_end": members.file.time.t_end,
            "conventions": CONVENTIONS,
            "versions": json.dumps(versions()),
        }
        group = zarr.create_group(str(temporary), attributes=record)

        def add(name: str, shape: tuple[int, ...], fill: Any, dims: tuple[str, ...], attributes: Any) -> None:
            group.create_array(
                name,
                shape=(m, *shape),
                chunks=(block, *shape),
                dtype=type(fill),
                fill_value=fill,
                compressors=zarr.codecs.Crc32cCodec(),
                chunk_key_encoding={"name": "default", "separator": "."},
                dimension_names=("member", *dims),
                attributes=attributes,
            )

        for name, (dims, own) in members.kept.items():
            add(name, members.shapes[name], np.float64(np.nan), dims, own)
        add("status", (), np.int8(ABSENT), (), status_attributes(statuses))
        group.create_group("blocks")
        with warnings.catch_warnings(action="ignore"):  # that other readers may not know consolidated metadata
            zarr.consolidate_metadata(str(temporary))
        metadata = {str(place.relative_to(temporary).as_posix()): place for place in temporary.rglob("zarr.json")}
        hashes = {name: hashlib.sha256(place.read_bytes()).hexdigest() for name, place in sorted(metadata.items())}
        with atomic_file(temporary / SEAL) as file:
            file.write(sealed({"files": hashes}))
    return SweepStore(path, members=members)


def _sha256(array: Array) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()
