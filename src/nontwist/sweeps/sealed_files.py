"""The files of a sealed store for Zarr: compared with their hashes on reading, hashed on writing."""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections.abc import AsyncGenerator, Iterable
from pathlib import Path
from typing import Any

from zarr.storage import LocalStore, WrapperStore

from .seals import CHANGED, Marks, Seal, damaged

CHUNK = re.compile(r"([^/]+)/c\.(\d+)(?:\.\d+)*")


class SealedFiles(WrapperStore[LocalStore]):
    """A store of files that returns sealed files only.

    A chunk whose block had no marker when the store was opened is absent, so that a sweep that is still running shows
    whole blocks alone. `hashes` collects the SHA-256 of the bytes that are handed to the file system, by their key:
    a marker holds the hash of the data, not of what the disk returns.
    """

    def __init__(self, store: LocalStore, seal: Seal, marks: Marks, present: bytearray) -> None:
        super().__init__(store)
        self.seal, self.marks, self.present = seal, marks, present
        self.hashes: dict[str, str] = {}

    def _with_store(self, store: LocalStore) -> SealedFiles:
        return SealedFiles(store, self.seal, self.marks, self.present)

    def __dask_tokenize__(self) -> tuple[str, str, bytes]:
        return str(self.marks.path), self.seal.sha256, bytes(self.present)

    async def get(self, key: str, prototype: Any, byte_range: Any = None) -> Any:
        """Return a file whose hash agrees, or None where none is sealed."""
        found = await asyncio.to_thread(self._checked, key)
        if found is None or byte_range is None:
            return None if found is None else prototype.buffer.from_bytes(found)
        return await self._store.get(key, prototype, byte_range)

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return parts of files whose hashes agree."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def _get_many(self, requests: Iterable[tuple[str, Any, Any]]) -> AsyncGenerator[tuple[str, Any], None]:
        for key, prototype, byte_range in requests:
            yield key, await self.get(key, prototype, byte_range)

    async def set(self, key: str, value: Any) -> None:
        """Write a file and keep its hash."""
        self.hashes[key] = await asyncio.to_thread(lambda: hashlib.sha256(value.as_numpy_array()).hexdigest())
        await self._store.set(key, value)

    def _checked(self, key: str) -> bytes | None:
        """Return the bytes of a file whose hash agrees; None where none is expected."""
        chunk = CHUNK.fullmatch(key)
        if key not in self.seal.files if chunk is None else not self.present[int(chunk[2])]:
            return None
        expected = self.seal.files[key] if chunk is None else self.marks.read(int(chunk[2])).chunks[chunk[1]]
        found = _read(self.marks.path / key)
        if (None if found is None else hashlib.sha256(found).hexdigest()) == expected:
            return found
        if chunk is None:
            raise damaged(self.marks.path, f"{key} {_fault(found)}")
        raise self.marks.damaged(int(chunk[2]), f"{chunk[1]} {_fault(found)}")


def _read(place: Path) -> bytes | None:
    try:
        return place.read_bytes()
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        return None


def _fault(found: bytes | None) -> str:
    return "is missing" if found is None else CHANGED
