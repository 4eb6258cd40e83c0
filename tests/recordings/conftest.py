"""What the tests of sound recordings share."""

import pytest

from nontwist.recordings.formats import libraries


@pytest.fixture
def libraries_read_here(monkeypatch):
    """Not in processes of their own."""
    monkeypatch.setattr(libraries, "read_apart", lambda function, path: function(str(path)))
