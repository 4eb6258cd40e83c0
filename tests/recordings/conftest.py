"""What the tests of sound recordings share."""

import pytest

from nontwist.recordings.formats import arrays


@pytest.fixture(autouse=True)
def matlab_is_read_here(monkeypatch):
    """Not in a process of its own, as files of C3D are."""
    monkeypatch.setattr(arrays, "read_apart", lambda function, path: function(str(path)))
