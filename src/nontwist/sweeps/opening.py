"""What is made of a store: a dataset, one of its members run again in full, a figure over swept keys."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, cast
from uuid import uuid4

import numpy as np

from ..analysis.variables import COORDINATES
from ..driver.runs import simulate
from ..geometry.arrays import Array, Dataset
from ..geometry.values import as_whole
from ..integrators import SimulationError
from ..plot.journals import column_width, new_axes, style
from ..plot.looks import symbol, unit
from ..runfile.document import unit_of
from ..runfile.sweep_table import Sweep
from .members import signs, values
from .store import Blocks, SweepStore, open_store

# What three numbers of a key are components along; those of a load by their last word.
DIMS = {"start.rotation": "quat", "start.angular_velocity.space": "axis", "start.angular_velocity.body": "director"}
DIMS |= {"body.gravity": "axis"} | dict.fromkeys(("body.axis", "body.centre_of_mass", "body.inertia"), "director")
DIMS |= dict.fromkeys(("field", "anchor", "vector", "radial", "normal"), "axis")
DIMS |= dict.fromkeys(("point", "axis", "coefficient"), "director")


def open_sweep(path: str | os.PathLike[str], *, verify: bool = True) -> Dataset:
    """Read the store of a sweep, complete or not, as a lazy dataset.

    Parameters
    ----------
    path : path
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
        `path` is not a path.
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
    return dataset(open_store(path, verify))


def dataset(kept: SweepStore) -> Dataset:
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
    every = COORDINATES | {"wheel": [*range(1, 1 + len(kept.members.file.prepared.plan.load.wheels))]}
    labels = {dim: labels for dim, labels in every.items() if dim in used}
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


def sweep_member(path: str | os.PathLike[str], member: int) -> Dataset:
    """Run one member of a sweep again, with all variables at the states given by ``time.store`` of the file.

    Parameters
    ----------
    path : path
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
        There is no such member, its numbers do not define a run, or `path` is not a path.
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
    kept = open_store(path)
    number = as_whole(member, "member", 0, len(kept.members) - 1)
    file = kept.members.member(number)
    try:
        run = simulate(file.problem)
    except SimulationError as error:
        run = error.partial.to_dataset()
    run["quaternion"] *= signs(run["quaternion"].values[-1])  # all of one sign, so that the last is that of the store
    own = {**file.record(), "title": f"member {number} of {kept.attributes['title']}"}
    return run.assign_attrs(own, member=number)


# A figure of one quantity over one or two swept keys.

MOST = 200_000  # members that are drawn
DENSE = 300  # points from which on dots replace discs
TICKS = 4  # intervals along x, whose labels then do not touch


def draw(store: str | os.PathLike[str], keys: Sequence[str], quantity: str) -> Any:
    """Draw a result of a sweep over swept keys.

    Parameters
    ----------
    store : path
    keys : 1 or 2 str
        Swept keys, or components of them: "body.axis", "body.axis.0".
    quantity : str
        A variable, or a component of it; of a vector of more than one the length is drawn.

    Returns
    -------
    Axes
        Of a new figure, one column wide. Its labels name components as the columns of exported tables do.

    Raises
    ------
    ValueError
        A key that was not swept, a quantity that was not kept or that no member has, or a whole matrix.
    """
    kept = open_store(store)
    data, sweep = dataset(kept), cast(Any, kept.members.sweep)
    swept = [one.key for one in sweep.over]
    every = slice(None, None, -(-data.sizes["member"] // MOST))
    across = [_component(data, key, swept, "was not swept", every) for key in keys]
    results = [str(name) for name in data.data_vars if name not in swept]
    drawn = _component(data, quantity, results, "was not kept", every)
    x, y = [one.numbers for one in across], drawn.numbers
    finite = np.isfinite(y)
    if not finite.any():
        raise ValueError(f"no member has a {quantity}: none is done, or all have failed")
    logarithmic = [one.key for one in sweep.over if getattr(one, "spacing", "") == "log" and one.start > 0]
    with style():
        ax: Any = new_axes(height=column_width() * (0.7 if len(keys) == 1 else 0.85))[0]
        ax.set_xlabel(across[0].column)
        if len(keys) == 1:
            ax.set_ylabel(drawn.label)
            _curve(ax, x[0][finite], y[finite], sweep)
        else:
            ax.set_ylabel(across[1].column)
            shown = _map(ax, x, y, sweep, keys, logarithmic) or _dots(ax, x[0][finite], x[1][finite], c=y[finite])
            ax.figure.colorbar(shown, ax=ax, label=drawn.label)
        for key, axis in zip(keys, "xy", strict=False):
            if key in logarithmic:
                ax.set(**{f"{axis}scale": "log"})
        if ax.get_xscale() == "linear":
            ax.locator_params(axis="x", nbins=TICKS)
        return ax


class _Component(NamedTuple):
    """Numbers of members, of a vector their lengths, and what labels call them."""

    numbers: Array
    column: str  # as in exported tables, quaternion_z, of a length between bars, and the unit
    label: str  # and the symbol, of a vector that of its length


def _component(data: Any, name: str, known: Sequence[str], fault: str, every: slice) -> _Component:
    """Return the variable that a name begins with, or the component that follows, of some members."""
    base = max((one for one in known if name == one or name.startswith(f"{one}.")), key=len, default=None)
    rest = name[len(base) + 1 :].split(".") if base is not None and name != base else []
    if base is None or not all(part.isdecimal() for part in rest):
        raise ValueError(f"{name} {fault}; known are {', '.join(known)}, and their components, as in {known[0]}.0")
    whole, place = data[base], [int(part) for part in rest]
    shape, left = whole.shape[1:], [n for n in whole.shape[1 + len(place) :] if n != 1]
    if len(place) > len(shape) or any(k >= n for k, n in zip(place, shape, strict=False)):
        ends = " × ".join(f"0 to {n - 1}" for n in shape)
        raise ValueError(f"{base} has components {ends}, not {name}")
    if len(left) > 1:
        size, last = " × ".join(map(str, left)), ".".join(str(n - 1) for n in left)
        one = f"name one of its components, as in {name}.{last}"
        raise ValueError(f"{name} is a matrix, {size}, which has no length; {one}")
    entry: Any = (slice(None), *place)
    numbers = np.asarray(whole[every].values, dtype=np.float64)[entry].reshape(-1, *left)
    labels = [str(whole[dim].values[k]) for dim, k in zip(whole.dims[1:], place, strict=False)]
    column = "_".join([base, *labels])
    if " " in whole.attrs.get("symbol", " "):  # of a reduction, which repeats the name
        label = name.replace("_", " ")
    else:
        text = symbol(whole, "".join(labels))
        label = f"{column if place else column.replace('_', ' ')} {f'|{text}|' if left else text}"
    numbers = np.sqrt((numbers * numbers).sum(axis=1)) if left else numbers
    return _Component(numbers, (f"|{column}|" if left else column) + unit(whole), label + unit(whole))


def _dots(ax: Any, x: Array, y: Array, **colour: Any) -> Any:
    size = 9 if len(x) < DENSE else max(0.3, 9 * DENSE / len(x))
    return ax.scatter(x, y, s=size, linewidths=0, rasterized=len(x) > 5000, **colour)


def _curve(ax: Any, x: Array, y: Array, sweep: Any) -> None:
    """Draw a line where one key alone was swept, along a grid or a list; dots else."""
    if len(sweep.over) == 1 and len(sweep.axes) == 1 and sweep.samples == 1:
        order = np.argsort(x, kind="stable")
        ax.plot(x[order], y[order], marker="." if len(x) < 50 else None)
    else:
        _dots(ax, x, y)


def _map(
    ax: Any, x: Sequence[Array], values: Array, sweep: Any, keys: Sequence[str], logarithmic: Sequence[str]
) -> Any:
    """Draw cells, where the sweep is the product of two grids and nothing else."""
    whole = [one.key for one in sweep.axes]
    if sweep.drawn or sweep.combine != "product" or sorted(whole) != sorted(keys) or len(values) != sweep.members:
        return None
    order = [whole.index(key) for key in keys]
    a, b, values = (one.reshape(sweep.shape).transpose(order) for one in (*x, values))
    grids = a[:, 0], b[0]
    a, b = (_borders(one, key in logarithmic) for one, key in zip(grids, keys, strict=True))
    cells = values[np.ix_(*map(np.argsort, grids))]
    return ax.pcolormesh(a, b, cells.T, shading="flat", rasterized=True)


def _borders(values: Array, logarithmic: bool) -> Array:
    """Return the borders of the cells of a grid, half way between its values, increasing."""
    x = np.sort(np.log(values) if logarithmic else values)
    ends = [2 * x[0] - x[1], *x, 2 * x[-1] - x[-2]] if len(x) > 1 else [x[0] - 1, x[0], x[0] + 1]
    borders: Array = np.convolve(ends, [0.5, 0.5], "valid")
    return np.exp(borders) if logarithmic else borders
