"""`edge` opens nothing to the network unless configured, and compares no secret byte by byte."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import edge
from edge.bus.session import session_config
from edge.bus.zenoh_file import open_addresses
from edge.config import Config, load
from edge.host.resources import data_dir

SOURCES = sorted(Path(edge.__file__).parent.rglob("*.py"))
EVERYWHERE = re.compile(r"0\.0\.0\.0|\[?::\]?(:\d+)?")
ADDRESS = re.compile(r"(^|_)(host|address|bind|endpoint|listen)$")
SECRETS = "password|passwd|secret|api_key|bearer|authorization|auth_token|access_token"
SECRET = re.compile(rf"(^|_)({SECRETS})$")
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def named(node: ast.AST) -> str:
    return str(getattr(node, "id", getattr(node, "attr", "")))


def separators(nodes: list[ast.AST]) -> set[int]:
    """Return parts of formatted texts, and separators: `::` also occurs in type names."""
    formatted = (node for node in nodes if isinstance(node, ast.JoinedStr))
    pieces = {id(value) for node in formatted for value in node.values}
    calls = (node for node in nodes if isinstance(node, ast.Call) and named(node.func) == "split")
    return pieces | {id(argument) for node in calls for argument in node.args}


@cache
def problems() -> tuple[list[tuple[str, str]], list[tuple[str, int]]]:
    """Addresses of every network that are said, and lines where a secret is compared.

    Trees are let go one by one: all of them, as objects that stay, slow every test that follows.
    """
    said, compared = [], []
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        if not (EVERYWHERE.search(source) or re.search(SECRETS, source)):
            continue
        nodes = list(ast.walk(ast.parse(source)))
        no_addresses = separators(nodes)
        for node in nodes:
            match node:
                case ast.Constant(value=str(text)) if EVERYWHERE.fullmatch(text):
                    said += [(path.name, text)] if id(node) not in no_addresses else []
                case ast.Compare(ops=[ast.Eq() | ast.NotEq(), *_]):
                    sides = (node.left, *node.comparators)
                    compared += [
                        (path.name, node.lineno) for side in sides if SECRET.search(named(side))
                    ]
    return said, compared


def test_no_address_of_every_network_is_written_in_the_code():
    assert problems()[0] == []


def test_secrets_are_compared_in_constant_time():
    assert problems()[1] == []


def defaults(schema: dict, name: str = "") -> Iterator[tuple[str, object]]:
    """(name, default) of every setting in a JSON schema."""
    for key, value in schema.items():
        if isinstance(value, dict):
            if "default" in value:
                yield key, value["default"]
            yield from defaults(value, key)


def test_every_address_is_local_by_default():
    found = [
        (name, default)
        for name, default in defaults(Config.model_json_schema())
        if ADDRESS.search(name) and isinstance(default, str)
    ]
    assert found
    assert [pair for pair in found if not any(own in pair[1] for own in LOOPBACK)] == []


@pytest.mark.parametrize("path", sorted(data_dir("config").glob("*.yaml")), ids=lambda p: p.stem)
def test_no_ready_configuration_is_open(path):
    assert open_addresses(session_config(load(str(path)).zenoh, "listen")) == []
