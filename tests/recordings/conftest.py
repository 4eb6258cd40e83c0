"""What the tests of sound recordings share."""

import pytest

from nontwist.recordings.formats import libraries


@pytest.fixture(autouse=True)
def matlab_is_read_here(monkeypatch):
    """Not in a process of its own, as files of C3D are."""
    apart = libraries.read_apart

    def read(function, path):
        return function(str(path)) if function is libraries.loaded else apart(function, path)

    monkeypatch.setattr(libraries, "read_apart", read)
