"""Nothing of `edge` is open to the network, and no secret is compared byte by byte, unless told."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import edge
from edge.bus.session import session_config
from edge.bus.zenoh_file import open_to
from edge.config import Config, load
from edge.host.resources import data_dir

SOURCES = sorted(Path(edge.__file__).parent.rglob("*.py"))
EVERYWHERE = re.compile(r"0\.0\.0\.0|\[?::\]?(:\d+)?")
ADDRESS = re.compile(r"(^|_)(host|address|bind|endpoint|listen)$")
SECRET = re.compile(
    r"(^|_)(password|passwd|secret|api_key|bearer|authorization|auth_token|access_token)$"
)
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@cache
def every_node() -> list[tuple[Path, ast.AST]]:
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}
    return [(path, node) for path, tree in trees.items() for node in ast.walk(tree)]


def nodes(kind: type[ast.AST]) -> Iterator[tuple[Path, ast.AST]]:
    return ((path, node) for path, node in every_node() if isinstance(node, kind))


def named(node: ast.AST) -> str:
    return str(getattr(node, "id", getattr(node, "attr", "")))


def separators() -> set[int]:
    """Pieces of formatted texts, and what texts are split at: `::` also parts names of types."""
    pieces = {id(value) for _, node in nodes(ast.JoinedStr) for value in node.values}
    calls = (node for _, node in nodes(ast.Call) if named(node.func) == "split")
    return pieces | {id(argument) for node in calls for argument in node.args}


def test_no_address_of_every_network_is_written_in_the_code():
    no_addresses = separators()
    said = [
        (path.name, node.value)
        for path, node in nodes(ast.Constant)
        if isinstance(node.value, str) and EVERYWHERE.fullmatch(node.value)
        if id(node) not in no_addresses
    ]
    assert said == []


def test_secrets_are_compared_in_constant_time():
    compared = [
        (path.name, node.lineno)
        for path, node in nodes(ast.Compare)
        for side in (node.left, *node.comparators)
        if isinstance(node.ops[0], (ast.Eq, ast.NotEq)) and SECRET.search(named(side))
    ]
    assert compared == []


def defaults(schema: dict, name: str = "") -> Iterator[tuple[str, object]]:
    """(name, default) of every setting in a JSON schema."""
    for key, value in schema.items():
        if isinstance(value, dict):
            if "default" in value:
                yield key, value["default"]
            yield from defaults(value, key)


def test_every_address_is_this_machines_own_by_default():
    found = [
        (name, default)
        for name, default in defaults(Config.model_json_schema())
        if ADDRESS.search(name) and isinstance(default, str)
    ]
    assert found
    assert [pair for pair in found if not any(own in pair[1] for own in LOOPBACK)] == []


@pytest.mark.parametrize("path", sorted(data_dir("config").glob("*.yaml")), ids=lambda p: p.stem)
def test_no_ready_configuration_is_open(path):
    assert open_to(session_config(load(str(path)).zenoh, "listen")) == []
