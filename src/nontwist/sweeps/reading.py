"""A store as a dataset, and one of its members run again in full."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from ..analysis.variables import COORDINATES
from ..driver.runs import simulate
from ..geometry.arrays import Array
from ..geometry.values import as_whole
from ..integrators import SimulationError
from ..runfile import RunFile
from ..runfile.document import checked, unit_of
from ..runfile.sweep_table import Sweep
from .members import signs, values
from .store import Blocks, SweepStore, open_store

if TYPE_CHECKING:
    import xarray

# What three numbers of a key are components along; those of a load by their last word.
DIMS = {"start.rotation": "quat", "start.angular_velocity.space": "axis", "start.angular_velocity.body": "director"}
DIMS |= {"body.gravity": "axis"} | dict.fromkeys(("body.axis", "body.centre_of_mass", "body.inertia"), "director")
DIMS |= dict.fromkeys(("field", "anchor", "vector", "radial", "normal"), "axis")
DIMS |= dict.fromkeys(("point", "axis", "coefficient"), "director")


def open_sweep(store: str | os.PathLike[str], *, verify: bool = True) -> xarray.Dataset:
    """Read the store of a sweep, complete or not, as a lazy dataset.

    Parameters
    ----------
    store : path
    verify : bool
        Compare what is read with the SHA-256 that was written with it: the metadata at once, the numbers of a block
        when they are read. With False only the CRC-32C of chunks is verified, as by any other Zarr reader.

    Returns
    -------
    xarray.Dataset
        On `member`: the stored variables at t_end; `status`, which is 0 for a completed run; and, under their keys, the
        swept numbers. Chunks are blocks, and are read on access. A block that was not complete when the store was
        opened has the status −2 and no numbers. The attribute `verified` is 1 if files are verified when read,
        otherwise 0; `seal` is the hash of the seal of the metadata, or states why there is none.

    Raises
    ------
    ValueError
        `store` is not a path.
    SweepStoreError
        The folder is not the store of a sweep, or its metadata are damaged. Reading the dataset also raises it, and
        names the block, if a block is damaged, exchanged, incomplete or from another store; other blocks can be read.
    RunFileError
        A table or a mesh named in the run file of the store is missing, or was changed.
    FileNotFoundError
        The folder does not exist.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import open_sweep, sweep
    >>> text = '''
    ... body = { kind = "standard", inertia = [3, 4, 5] }
    ... start.angular_velocity.body = [0, 1, 0]
    ... time = { t_end = 1, step = 0.1 }
    ... sweep = { samples = 50, over = [{ key = "start.rotation", kind = "rotation" }] }
    ... '''
    >>> _ = Path("sweep.toml").write_text(text)
    >>> _ = sweep("sweep.toml", "attitudes", workers=1)
    >>> data = open_sweep("attitudes")
    >>> data.sizes["member"], int((data.status == 0).sum())
    (50, 50)

    Members lie along one dimension. Where they are a product of grids or lists of numbers, each key can have its own:

    >>> keys = ["body.inertia.0", "body.inertia.2"]
    >>> over = ", ".join(f'{{ key = "{key}", kind = "list", values = [3, 4, 5] }}' for key in keys)
    >>> _ = Path("grid.toml").write_text(text.split("sweep")[0] + f"sweep = {{ over = [{over}] }}")
    >>> data = sweep("grid.toml", "grid", workers=1)
    >>> dict(data.set_coords(keys).set_index(member=keys).unstack("member").status.sizes)
    {'body.inertia.0': 3, 'body.inertia.2': 3}
    """
    return dataset(open_store(store, verify))


def dataset(kept: SweepStore) -> xarray.Dataset:
    """Return the dataset of a store, as `open_sweep`; its arrays are read, and swept numbers made again, by blocks."""
    import xarray

    present, sweep, found = bytes(kept.blocks.present()), kept.members.sweep, dict[str, Any]()
    for name in kept.names:
        stored = kept.group[name]
        data = _lazy(kept, partial(_stored, kept.blocks, present, name), stored.shape[1:], stored.dtype)
        found[name] = (stored.metadata.dimension_names, data, dict(stored.attrs))
    for key, array in values(sweep, 0, 1).items():
        shape = array.shape[1:]
        named = DIMS.get(key.rpartition(".")[2] if key.startswith("load.") else key)
        own = (named,) if named and len(shape) == 1 else tuple(f"{key}.{n}" for n in range(len(shape)))
        known = unit_of(kept.members.file, key)
        attributes = {"long_name": f"{key}, swept"} | ({} if known is None else {"units": known})
        data = _lazy(kept, partial(_swept, kept.blocks, sweep, key), shape, array.dtype)
        found[key] = (("member", *own), data, attributes)
    used = {dim for dims, *_ in found.values() for dim in dims}
    labels = {dim: labels for dim, labels in COORDINATES.items() if dim in used}
    record = {"verified": int(bool(kept.blocks.seal)), "seal": kept.seal_words}
    return xarray.Dataset(found, labels, kept.attributes | record)


def _lazy(kept: SweepStore, block: Callable[..., Array], shape: tuple[int, ...], dtype: Any) -> Any:
    """Return a lazy array of members, each chunk of which is what `block` returns for ``block_id``."""
    import dask.array

    lazy: Any = dask.array
    sizes = tuple(last - first for first, last in map(kept.blocks.span, range(kept.blocks.count)))
    chunks, empty = (sizes, *((n,) for n in shape)), np.empty((0,) * (1 + len(shape)), dtype)
    return lazy.map_blocks(block, chunks=chunks, dtype=dtype, meta=empty, name=f"sweep-{uuid4().hex}")


def _stored(blocks: Blocks, present: bytes, name: str, block_id: tuple[int, ...]) -> Array:
    """Return the stored numbers of a block that was there when the store was opened; unverified, what is there."""
    if present[block_id[0]] or not blocks.seal:
        return blocks.array(name, block_id[0])
    array, (first, last) = blocks.group[name], blocks.span(block_id[0])
    return np.full((last - first, *array.shape[1:]), array.fill_value, array.dtype)


def _swept(blocks: Blocks, sweep: Sweep, key: str, block_id: tuple[int, ...]) -> Array:
    return values(sweep, *blocks.span(block_id[0]))[key]


def sweep_member(store: str | os.PathLike[str], member: int) -> xarray.Dataset:
    """Run one member of a sweep again, with all variables at the states given by ``time.store`` of the file.

    Parameters
    ----------
    store : path
    member : int
        Number of the member, from 0.

    Returns
    -------
    xarray.Dataset
        A run. On the same type of processor and with the same packages, its last state equals that of the store bit for
        bit; if the member fails, the run ends there. Its attribute `run_file` is the run file of this member.

    Raises
    ------
    ValueError
        There is no such member, its numbers do not define a run, or `store` is not a path.
    SweepStoreError
        The folder is not the store of a sweep, or its metadata are damaged.
    FileNotFoundError
        The folder does not exist.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import sweep, sweep_member
    >>> text = '''
    ... body = { kind = "standard", inertia = [3, 4, 5] }
    ... start.angular_velocity.body = [0, 1, 0]
    ... time = { t_end = 1, step = 0.1 }
    ... sweep = { samples = 50, over = [{ key = "start.rotation", kind = "rotation" }] }
    ... '''
    >>> _ = Path("sweep.toml").write_text(text)
    >>> data, run = sweep("sweep.toml", "attitudes", workers=1), sweep_member("attitudes", 7)
    >>> run.sizes["time"], bool((run.quaternion[-1] == data.quaternion[7]).all())
    (11, True)
    """
    kept = open_store(store)
    number = as_whole(member, "member", 0, len(kept.members) - 1)
    file = member_file(kept, number)
    try:
        run = simulate(file.problem)
    except SimulationError as error:
        run = error.partial.to_dataset()
    run["quaternion"] *= signs(run["quaternion"].values[-1])  # all of one sign, so that the last is that of the store
    own = {**file.record(), "title": f"member {number} of {kept.attributes['title']}"}
    return run.assign_attrs(own, member=number)


def member_file(kept: SweepStore, member: int) -> RunFile:
    """Return the run file of one member, its numbers inserted; a ValueError where they define no run."""
    numbers = values(kept.members.sweep, member, member + 1)
    return checked(f"member {member}", kept.members.data_of(numbers), kept.members.folder)
