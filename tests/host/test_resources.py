"""Locations of files, also for a user without a home."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.config import ConfigError
from edge.host import resources


@pytest.fixture
def homeless(monkeypatch):
    def expanduser(path):
        if str(path).startswith("~"):
            raise RuntimeError("Could not determine home directory.")
        return path

    for name in ("EDGE_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "expanduser", expanduser)


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"EDGE_CACHE_DIR": "/a", "XDG_CACHE_HOME": "/b", "HOME": "/c"}, "/a"),
        ({"EDGE_CACHE_DIR": "~/a", "HOME": "/c"}, "/c/a"),
        ({"EDGE_CACHE_DIR": "", "XDG_CACHE_HOME": "/b", "HOME": "/c"}, "/b/edge-vln"),
        ({"EDGE_CACHE_DIR": "", "XDG_CACHE_HOME": "", "HOME": "/c"}, "/c/.cache/edge-vln"),
    ],
)
def test_the_cache(environ, expected, monkeypatch):
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    assert resources.cache_dir() == Path(expected)


def test_without_a_home_the_error_names_the_variable_to_set(homeless, monkeypatch):
    assert resources.user_cache() is None
    with pytest.raises(ConfigError, match="has no home folder: set EDGE_CACHE_DIR"):
        resources.cache_dir()
    with pytest.raises(ConfigError, match=r"^~/x\.yaml: .*set HOME, or give the path in full"):
        resources.find_config("~/x.yaml")
    monkeypatch.setenv("EDGE_CACHE_DIR", "/a")
    assert resources.models_dir() == Path("/a/models")


def test_a_folder_does_not_hide_a_built_in_configuration(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("demo", "mine"):
        (tmp_path / folder).mkdir()
    assert resources.find_config("demo") == resources.data_dir("config") / "demo.yaml"
    assert resources.find_config("./demo") == Path("demo")
    assert resources.find_config("mine") == Path("mine")
    (tmp_path / "cpu").write_text("mission: {}")
    assert resources.find_config("cpu") == Path("cpu")
