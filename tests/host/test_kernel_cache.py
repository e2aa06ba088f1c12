"""Numba finds a folder for compiled kernels wherever `edge` is started."""

from __future__ import annotations

import os
import tempfile

import pytest

from edge.config import ConfigError
from edge.host import resources
from edge.host.kernel_cache import kernel_cache

VARIABLES = ("NUMBA_CACHE_DIR", "EDGE_CACHE_DIR", "XDG_CACHE_HOME")


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Return a folder with `free`, where folders can be made, and `closed`, where none can."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "closed").touch()
    monkeypatch.setattr(resources, "PACKAGE", tmp_path / "closed" / "code")
    monkeypatch.setenv("HOME", str(tmp_path / "closed" / "home"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path


def chosen() -> str | None:
    with kernel_cache():
        return os.environ.get("NUMBA_CACHE_DIR")


@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_a_writable_numba_cache_is_left_alone(variable, places, monkeypatch, caplog):
    monkeypatch.setenv(variable, str(places / "free"))
    assert chosen() == os.environ.get("NUMBA_CACHE_DIR")
    assert not caplog.records


@pytest.mark.parametrize("ours", [None, "closed/cache"])
def test_without_a_cache_folder_a_temporary_one_is_used(ours, places, monkeypatch, caplog):
    if ours is not None:
        monkeypatch.setenv("EDGE_CACHE_DIR", str(places / ours))
    folder = places / "temporary" / f"edge-kernels-{os.getuid()}"
    assert chosen() == str(folder)
    (record,) = caplog.records
    (folder / "kernel").touch()
    assert chosen() == str(folder)
    assert (folder / "kernel").exists()  # the next start need not compile it
    assert "set EDGE_CACHE_DIR (or NUMBA_CACHE_DIR)" in record.getMessage()


def test_a_temporary_folder_that_others_can_write_is_refused(places, monkeypatch):
    folder = places / "temporary" / f"edge-kernels-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(ConfigError, match="other users can write here: set EDGE_CACHE_DIR"):
        chosen()
    folder.rmdir()
    folder.mkdir(mode=0o700)
    another = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: another)
    folder.rename(folder.with_name(f"edge-kernels-{os.getuid()}"))  # that of another user
    with pytest.raises(ConfigError, match="other users can write here"):
        chosen()


def test_a_link_is_no_temporary_folder(places):
    (places / "temporary" / f"edge-kernels-{os.getuid()}").symlink_to(places)
    with pytest.raises(ConfigError, match="other users can write here"):
        chosen()


def test_without_any_folder_the_error_names_the_remedy(places, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(places / "closed"))
    with pytest.raises(ConfigError, match="set EDGE_CACHE_DIR"):
        chosen()
