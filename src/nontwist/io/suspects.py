"""Detection of what `save_run` never writes: links, external arrays, and arrays larger than the file."""

from __future__ import annotations

import os
from typing import Any, BinaryIO

NO_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"  # the NAME of a scale, which nobody reads


def suspect(file: BinaryIO) -> str | None:
    """Return what an HDF5 file has that `save_run` does not write, in words, or None; no array is read.

    These are links, arrays that are kept in other files, and more numbers than there are bytes.
    """
    import h5py
    from h5py import h5d, h5g, h5l, h5o

    size, total = os.fstat(file.fileno()).st_size, 0
    with h5py.File(file, "r") as opened:
        groups: list[Any] = [h5o.open(opened.id, b"/")]
        seen = {h5o.get_info(groups[0]).addr}
        while groups:
            group = groups.pop()
            for name in group:
                words = repr(name.decode(errors="replace"))
                if group.links.get_info(name).type != h5l.TYPE_HARD:
                    return f"{words} is a link to another place or file"
                found = h5o.open(group, name)
                if isinstance(found, h5d.DatasetID):
                    array = h5py.Dataset(found)
                    if array.is_virtual or array.external:
                        return f"the numbers of {words} are kept in other files"
                    total += 0 if bytes(array.attrs.get("NAME", b"")).startswith(NO_VARIABLE) else array.nbytes
                    if total > size:
                        return f"up to {words} its arrays take {total} bytes, but it has {size}"
                elif isinstance(found, h5g.GroupID) and (at := h5o.get_info(found).addr) not in seen:
                    seen.add(at)
                    groups.append(found)
    return None
