"""What the package says of its inputs: tests compare codes and fields, not sentences."""

import warnings
from contextlib import contextmanager

import pytest

from nontwist.errors import InputError, InputWarning


@contextmanager
def refused(code, **fields):
    """Expect an InputError with this code and, among its fields, these."""
    with pytest.raises(InputError) as told:
        yield told
    assert told.value.code == code, told.value
    assert {name: told.value.fields.get(name) for name in fields} == fields


@contextmanager
def warned(*codes):
    """Expect these warnings, in this order and no others, of inputs; give the list of them."""
    caught = []
    with warnings.catch_warnings(record=True) as every:
        warnings.simplefilter("always")
        yield caught
    caught += [one.message for one in every if isinstance(one.message, InputWarning)]
    assert tuple(one.code for one in caught) == codes, [str(one.message) for one in every]
