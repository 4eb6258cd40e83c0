"""The seal of a store: hashes of its metadata, and of every block.

``blocks/seal.json`` is written when a store is made: the SHA-256 of each ``zarr.json``. The marker of a block, written
when the block is done, repeats the hash of the seal, so that a block of another store is recognised, and holds the
number of the block and the SHA-256 of each of its chunk files. Both carry a hash of their own text. Nothing here is a
signature: who can write a store can seal it again.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import SweepStoreError
from ..io.whole import atomic_file

SEAL = "blocks/seal.json"  # where readers of Zarr do not look for arrays
CHANGED = "was changed after it was written"


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
    sha256: str  #: of its numbers
    failed: int  #: members with a status other than 0
    reasons: dict[str, str]  #: why, by their numbers
    seconds: float
    chunks: dict[str, str | None]  #: SHA-256 of the file of each variable; None where it has none, as all is NaN


class Seal(NamedTuple):
    """The hashes of the metadata of a store when it was made."""

    sha256: str
    files: dict[str, str]  #: SHA-256 of each, by its path in the store


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


def write_seal(path: Path) -> None:
    """Seal the metadata of a new store."""
    files = {str(place.relative_to(path).as_posix()): _hash(place) for place in sorted(path.rglob("zarr.json"))}
    with atomic_file(path / SEAL) as file:
        file.write(sealed({"files": files}))


def read_seal(path: Path) -> Seal | None:
    """Compare the metadata of a store with its seal and return it; None where there is none.

    Raises
    ------
    SweepStoreError
        The seal or a file of metadata is damaged.
    """
    try:
        data = unsealed((path / SEAL).read_bytes())
        seal = Seal(data["seal"], dict(data["files"]))
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise damaged(path, f"{SEAL} {CHANGED}") from error
    for name, expected in seal.files.items():
        try:
            found = _hash(path / name)
        except FileNotFoundError as error:
            raise damaged(path, f"{name} is missing") from error
        if found != expected:
            raise damaged(path, f"{name} {CHANGED}")
    return seal


def damaged(path: Path, reason: str) -> SweepStoreError:
    """Return the error of a store whose metadata were changed."""
    remedy = "run the sweep into a new store, or read this one unchecked with open_sweep(..., verify=False)"
    return SweepStoreError(f"{path} is damaged: {reason}; {remedy}")


def _hash(place: Path) -> str:
    return hashlib.sha256(place.read_bytes()).hexdigest()


class Marks:
    """The markers of a store's blocks.

    Parameters
    ----------
    path : Path
        The store.
    block, members : int
        Members of a block, and of the sweep.
    seal : Seal or None
        None where it is not verified.
    """

    def __init__(self, path: Path, block: int, members: int, seal: Seal | None) -> None:
        self.path, self.block, self.members, self.seal = path, block, members, seal

    @property
    def blocks(self) -> int:
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

    def present(self) -> bytearray:
        """Return for each block whether it has a marker, 0 or 1; no marker is read."""
        found = bytearray(self.blocks)
        for first in range(0, self.blocks, 1000):
            folder = self.place(first).parent
            names = set(os.listdir(folder)) if folder.is_dir() else set()
            for k in range(first, min(first + 1000, self.blocks)):
                found[k] = self.place(k).name in names
        return found

    def write(self, done: Done) -> None:
        """Mark a block as done."""
        assert self.seal is not None
        place = self.place(done.block)
        place.parent.mkdir(exist_ok=True)
        with atomic_file(place) as file:
            file.write(sealed({**done._asdict(), "store": self.seal.sha256}))

    def read(self, k: int) -> Done:
        """Return the marker of a block.

        Raises
        ------
        DamagedBlockError
            The marker is missing or damaged, or is that of another block or store.
        """
        try:
            text = self.place(k).read_bytes()
            data = json.loads(text) if self.seal is None else unsealed(text)
            done = Done(**{name: data[name] for name in Done._fields})
        except FileNotFoundError as error:
            raise self.damaged(k, "its marker was removed after the store was opened") from error
        except (ValueError, TypeError, KeyError) as error:
            raise self.damaged(k, f"its marker {CHANGED}") from error
        if self.seal is not None and data.get("store") != self.seal.sha256:
            raise self.damaged(k, "it belongs to another store")
        if done.block != k:
            raise self.damaged(k, f"block {done.block} is in its place")
        return done

    def damaged(self, k: int, reason: str) -> DamagedBlockError:
        """Return the error that names a block and the reason."""
        return DamagedBlockError(f"{self.path}: {self.name(k)}", reason)
