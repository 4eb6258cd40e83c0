"""Wrong values for any parameter: what no function takes, and valid values damaged in one place."""

import datetime
from decimal import Decimal
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pandas
import scipy.sparse
import xarray

ENDLESS = []
ENDLESS.append(ENDLESS)
EXTREME = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 1e101, 1e-101, 1e-200, 5e-324, -0.0, 0.0, -1.0)
WHOLE = (True, -1, 2**70, 10**400, 10**5000)
NUMBERS = (*WHOLE, 1j, np.float16(1), np.longdouble("1e4000"), Fraction(1, 3), Decimal("sNaN"))
NOTHING = ("", (), [], {}, set(), np.empty(0), np.empty((0, 3)), np.zeros((2, 0, 3)), xarray.Dataset())
TEXTS = ("x", "\0", "'; DROP", "é" * 300, b"x", ["x", "y", "z"], np.array(["a", "b", "c"]))
LISTS = ([[1], [1, 2]], [None, 1.0], ENDLESS, (1j, 2, 3), np.array([1, None, "x"], dtype=object))
OBJECTS = (object(), len, SimpleNamespace(dtype="float", shape=(3,), directors=1))
DATES = (
    *(np.datetime64("2026-01-01"), np.datetime64("NaT", "s"), np.timedelta64(3, "s"), datetime.datetime(2026, 1, 1)),
    np.array(["2026-01-01", "NaT"], "M8[ns]"),
)
MASKED = (np.ma.masked, np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0]))
ARRAYS = (np.zeros(3), np.ones((1,) * 40), np.full((3, 3), np.nan), np.eye(3), np.eye(3, dtype=complex))
TABLES = (
    *(np.zeros(3, "i4,f8"), scipy.sparse.eye_array(3), pandas.Series([1.0, None, 3.0]), xarray.DataArray([1.0, 2.0])),
    pandas.DataFrame({"a": [1, 2], "b": ["x", "y"]}),
    pandas.DataFrame({"w": [1, 1], "x": [0, 0], "y": [0, 0], "z": [0, 1j]}),
    xarray.Dataset({"directors": ("time", [1.0, 2.0])}, attrs={"system": "null"}),
)
THINGS = (None, *EXTREME, *NUMBERS, *NOTHING, *TEXTS, *LISTS, *OBJECTS, *DATES)
THINGS += (*MASKED, [MASKED[1]] * 3, *ARRAYS, *TABLES)


def damaged(r, value):
    """`value` with one thing wrong with it, or at the border of what can be; `value` where it cannot be damaged."""
    if isinstance(value, xarray.Dataset):
        return _dataset(r, value)
    if isinstance(value, (bool, str)) or not isinstance(value, (int, float, tuple, list, np.ndarray)):
        return value
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return value
    return DAMAGES[r.integers(len(DAMAGES))](r, array)


def _dataset(r, data):
    name = list(data.variables)[r.integers(len(data.variables))]
    key = list(data.attrs)[r.integers(len(data.attrs))]
    first = next(iter(data.dims))
    return (
        lambda: data.drop_vars(name),
        lambda: data.drop_attrs(),
        lambda: data.assign_attrs({key: "null"}),
        lambda: data.assign_attrs({key: "{"}),
        lambda: data.assign_attrs({key: 3}),
        lambda: data.isel({first: [0]}),
        lambda: data.isel({first: []}),
        lambda: _times(data, name, np.nan),
        lambda: _times(data, name, 1j),
        lambda: data.astype(str),
        lambda: data.rename({first: "other"}),
        lambda: data.transpose(*reversed(list(data.dims))),
    )[r.integers(12)]()


def _times(data, name, factor):
    return data.assign({name: data[name] * factor}) if data[name].dtype.kind == "f" else data


def _entry(value):
    def put(r, array):
        array = array.copy()
        if array.size:
            array.flat[r.integers(array.size)] = value
        return array

    return put


DAMAGES = (
    *map(_entry, EXTREME),
    lambda r, array: array * 1e200,
    lambda r, array: array * 1e-200,
    lambda r, array: -array,
    lambda r, array: array * (1 + 1e-9),
    lambda r, array: array + 0j,
    lambda r, array: np.ma.masked_array(array, r.random(array.shape) < 0.5),
    lambda r, array: array.astype(object),
    lambda r, array: array.astype("f4"),
    lambda r, array: array.astype(int),
    lambda r, array: array.astype(bool),
    lambda r, array: array.astype(str),
    lambda r, array: (array * 1e9).astype("M8[ns]"),
    lambda r, array: array.tolist(),
    lambda r, array: array.T,
    lambda r, array: array[None],
    lambda r, array: array[..., None],
    lambda r, array: array[:0] if array.ndim else array,
    lambda r, array: array[:1] if array.ndim else array,
    lambda r, array: array[::-1] if array.ndim else array,
    lambda r, array: array.ravel(),
    lambda r, array: pandas.Series(array.ravel()),
    lambda r, array: xarray.DataArray(array),
)
