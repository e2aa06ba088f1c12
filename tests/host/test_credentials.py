"""Tokens, and files with secrets that a service manager may hand over."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.errors import ConfigError
from edge.host.credentials import (
    COPIES,
    BearerToken,
    credential_path,
    is_open_to_others,
    read_token,
)

SECRET = "0123456789abcdef"


def test_without_a_manager_a_secret_is_in_its_file(monkeypatch):
    monkeypatch.delenv(COPIES, raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    assert credential_path("name", "/etc/secret") == Path("/etc/secret")
    assert credential_path("name", "~/secret") == Path("/home/me/secret")


def test_a_copy_of_that_name_is_taken_in_its_place(tmp_path, monkeypatch):
    monkeypatch.setenv(COPIES, str(tmp_path))
    (tmp_path / "name").touch()
    assert credential_path("name", "/etc/secret") == tmp_path / "name"
    assert credential_path("other", "/etc/secret") == Path("/etc/secret")


@pytest.mark.parametrize(("mode", "open_"), [(0o600, False), (0o640, False), (0o604, True)])
def test_a_file_readable_by_others_is_detected(tmp_path, mode, open_):
    file = tmp_path / "secret"
    assert not is_open_to_others(file)
    file.touch()
    file.chmod(mode)
    assert is_open_to_others(file) is open_


@pytest.mark.parametrize(
    ("header", "known"),
    [
        (f"Bearer {SECRET}", True),
        (f"bearer  {SECRET} ", True),
        ("", False),
        (SECRET, False),
        ("Bearer", False),
        (f"Basic {SECRET}", False),
        (f"Bearer {SECRET}0", False),
        (f"Bearer {SECRET[:-1]}", False),
        ("Bearer \xe9\udcff", False),
    ],
)
def test_only_a_bearer_header_with_the_token_matches(header, known):
    token = BearerToken(SECRET.encode())
    assert token.matches(header) is known
    assert SECRET not in f"{token} {token!r}"


def test_a_token_is_read_from_its_file_or_copy(tmp_path, monkeypatch):
    (tmp_path / "token").write_text(f"{SECRET}\n")
    assert read_token("http.token_file", str(tmp_path / "token")).matches(f"Bearer {SECRET}")
    (tmp_path / "http.token_file").write_text(SECRET[::-1])
    monkeypatch.setenv(COPIES, str(tmp_path))
    token = read_token("http.token_file", "/root/only")
    assert token.matches(f"Bearer {SECRET[::-1]}")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "No such file"),
        ("", "one word of 16"),
        ("short", "one word of 16"),
        (f"{SECRET}\n{SECRET}", "one word of 16"),
        (f"{SECRET}é", "one word of 16"),
    ],
)
def test_an_invalid_token_is_refused_without_being_quoted(tmp_path, text, says):
    file = tmp_path / "token"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_token("http.token_file", str(file))
    assert str(caught.value).startswith(f"http.token_file: {file}: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert SECRET not in str(caught.value)
    assert "short" not in str(caught.value)
