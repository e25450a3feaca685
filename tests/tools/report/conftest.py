import pytest
from synthetic import SHORT, write_session


@pytest.fixture(scope="session")
def short_log(tmp_path_factory):
    """A short session with a few updates and an autonomous run."""
    return write_session(tmp_path_factory.mktemp("session") / "short.mcap", options=SHORT)
