"""A reader of YAML text that is not trusted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from edge.errors import ConfigError
from edge.host.files import read_regular
from edge.text import one_line

MAX_YAML_BYTES = 1 << 20
"""Size limit of a text."""
MAX_NODES = 20_000
"""Most keys and values of a text. An alias counts as all nodes that it stands for."""
MAX_DEPTH = 64
"""Largest nesting of sections and lists."""
_CHARS_PER_NODE = 64  # a long text counts as several nodes
_MAX_PLAIN_CHARS = 100  # of a number, a date or another value that is not text
_TOO_DEEP = f"nested too deeply (more than {MAX_DEPTH} levels)"
_TEXT = "tag:yaml.org,2002:str"
_MERGE = "tag:yaml.org,2002:merge"


def read_yaml(path: Path) -> Any:
    """Read a YAML file; see `parse_yaml`.

    Raises:
        ConfigError: the file cannot be read, or its content is refused; one line.
    """
    try:
        return parse_yaml(read_regular(path, MAX_YAML_BYTES))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def parse_yaml(text: str | bytes) -> Any:
    """Return the data of a YAML text.

    Raises:
        YamlTooLargeError: the text is longer or more deeply nested than a person writes. One line.
        ValueError: the text is not YAML or not UTF-8, has a Python tag, a value that does not fit
            its type (2024-13-45), a key twice, or too many keys and values. One line.
    """
    if len(text) > MAX_YAML_BYTES:
        raise YamlTooLargeError(f"longer than {MAX_YAML_BYTES} bytes")
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except _RefusedError:
        raise
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"not YAML: {one_line(error, 400)}") from None
    except RecursionError:
        raise YamlTooLargeError(_TOO_DEEP) from None
    except (AttributeError, IndexError, KeyError):  # PyYAML raises them at `!!timestamp x`
        raise ValueError(
            "not YAML: a value does not fit its tag (!!timestamp or another)"
        ) from None


class _RefusedError(ValueError):
    """Refused YAML; the message is one line."""


class YamlTooLargeError(_RefusedError):
    """YAML that is too long or too deeply nested; the message quotes nothing of the text."""


class _Loader(yaml.SafeLoader):
    """YAML loader that refuses large texts and duplicate keys before any object is built.

    With nested aliases, a text of 1 kB can stand for billions of values. The built objects share
    them, but code that walks through the data would not return.
    """

    def __init__(self, text: str | bytes) -> None:
        super().__init__(text)
        self._path: list[Any] = []  # keys and indices of the current node
        self._nodes = 0  # nodes so far
        self._height = 0  # levels below the current node, so far
        # Id of a finished node → number of nodes in it, and levels below it; for aliases of it.
        self._known: dict[int, tuple[int, int]] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node as PyYAML does, but count its nodes and levels, and refuse too many."""
        is_alias = self.check_event(yaml.AliasEvent)
        line = self.peek_event().start_mark.line + 1
        if index is not None:
            self._path.append(index.value if isinstance(index, yaml.ScalarNode) else index)
        before, outer_height, self._height = self._nodes, self._height, 0
        if len(self._path) > MAX_DEPTH:
            raise YamlTooLargeError(_TOO_DEEP)
        node = super().compose_node(parent, index)
        if is_alias:
            if id(node) not in self._known:  # the alias is inside its own anchor
                raise _RefusedError(
                    f"line {line}: an alias (*name) is inside the value that it stands for"
                )
            nodes, height = self._known[id(node)]
        else:
            nodes, height = 1, self._height
            if isinstance(node, yaml.ScalarNode):
                nodes += len(node.value) // _CHARS_PER_NODE
                self._check_plain(node, line)
        self._nodes += nodes
        if self._nodes > MAX_NODES:
            raise _RefusedError(
                f"line {line}: more than {MAX_NODES} keys and values up to here; an alias (*name) "
                "counts as all that it stands for: shorten the text, or use fewer aliases"
            )
        if len(self._path) + height > MAX_DEPTH:
            raise YamlTooLargeError(_TOO_DEEP)
        self._known[id(node)] = self._nodes - before, height
        self._height = max(outer_height, height + 1)
        if index is not None:
            self._path.pop()
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Compose a mapping as PyYAML does, but refuse a key that is given twice."""
        node = super().compose_mapping_node(anchor)
        first: dict[Any, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            # Compare the values, not the text: `on` and `yes` are the same key, and so are 1, 0x1.
            read = key.value if key.tag == _MERGE else self.construct_object(key)
            line = key.start_mark.line + 1
            if read in first:
                name = one_line(".".join(map(str, [*self._path, key.value])))
                raise _RefusedError(
                    f"line {line}: {name}: given twice, first in line {first[read]}: keep one"
                )
            first[read] = line
        return node

    def _check_plain(self, node: yaml.ScalarNode, line: int) -> None:
        if node.tag != _TEXT and len(node.value) > _MAX_PLAIN_CHARS:
            raise _RefusedError(
                f"line {line}: a number of more than {_MAX_PLAIN_CHARS} characters: quote it"
            )
