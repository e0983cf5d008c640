"""Shared set-up: nothing that a test opens touches the user's own state folder."""

import pytest
from channel_helpers import folders, pair  # noqa: F401  # fixtures
from gallery_session_helpers import galleries, no_sync  # noqa: F401
from port_helpers import open_port  # noqa: F401


@pytest.fixture(autouse=True)
def _own_state_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "xdg-state"))


@pytest.fixture
def quick_disk(monkeypatch):
    """For tests of many small sessions: nothing waits for the disk."""
    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(f"spdz.tape.durable.os.{name}", lambda descriptor: None, raising=False)
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))
