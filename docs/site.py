"""Pages that MkDocs makes from the project itself, so that they cannot differ from it.

The README is the home page. Configuration, commands and topics come from the JSON Schema, the
argument parsers and the topic table.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from edge.bus import topics
from edge.cli.parsers import make_parser
from edge.config import Config

ROOT = Path(__file__).parents[1]
OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+([\w./-]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "index.md": (ROOT / "README.md").read_text(encoding="utf-8"),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        "contributing.md": (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
        "reference/configuration.md": configuration_page(),
        "reference/commands.md": commands_page(),
        "reference/topics.md": topics_page(),
    }
    for path, text in pages.items():
        text = text.replace("](docs/", "](").replace('src="docs/', 'src="')
        text = text.replace("](CONTRIBUTING.md", "](contributing.md")
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Write the paths of files outside `docs` instead of links: the site does not have them."""
    return OUTSIDE.sub(r"\1 (`\2`)", markdown)


def configuration_page() -> str:
    """Return a table of keys for each section of the configuration."""
    schema = Config.model_json_schema()
    lines = ["# Configuration", ""]
    lines += [
        "One YAML file. `edge config NAME` prints it in full, `edge config --schema` its JSON"
    ]
    lines += ["Schema. Any key can come from the environment: `EDGE__POLICY__KIND=hvl`.", ""]
    for name, section in schema["properties"].items():
        lines += _section(name, section, schema["$defs"])
    return "\n".join(lines)


def _section(path: str, section: dict, definitions: dict) -> Iterator[str]:
    """Yield the lines of one section, then those of the sections in it."""
    for kind, found in _objects(section, definitions):
        title = f"`{path}`" + (f", kind `{kind}`" if kind else "")
        yield from ("", f"## {title}", "", found.get("description", ""), "")
        inner, rows = [], []
        for key, value in found.get("properties", {}).items():
            if any(_objects(value, definitions)):
                inner.append((f"{path}.{key}", value))
            else:
                default = json.dumps(value["default"]) if "default" in value else "required"
                rows.append(f"| `{key}` | {_type(value, definitions)} | `{default}` |")
        if rows:
            yield from ("| key | values | default |", "|---|---|---|", *rows)
        for each in inner:
            yield from _section(*each, definitions)


def _objects(value: dict, definitions: dict) -> list[tuple[str, dict]]:
    """Return the objects that a value may be, each with its `kind`, or with an empty one."""
    found = []
    for one in value.get("anyOf") or value.get("oneOf") or value.get("allOf") or [value]:
        one = _resolve(one, definitions)
        if "oneOf" in one or "anyOf" in one:
            found += _objects(one, definitions)
        elif "properties" in one:
            kind = one["properties"].get("kind", {})
            found.append((str(kind.get("const", "")), one))
    return found


def _resolve(value: dict, definitions: dict) -> dict:
    if "$ref" in value:
        return definitions[value["$ref"].rpartition("/")[2]]
    return value


def _type(value: dict, definitions: dict) -> str:
    """Return the values that a key takes, in words."""
    value = _resolve(value, definitions)
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return ", ".join(f"`{one}`" for one in value["enum"])
    if some := value.get("anyOf") or value.get("oneOf"):
        return " or ".join(dict.fromkeys(_type(one, definitions) for one in some))
    words = value.get("type", "any")
    if words == "array":
        words = f"list of {_type(value.get('items', {}), definitions)}"
    limits = {"minimum": "≥ ", "exclusiveMinimum": "> ", "maximum": "≤ ", "exclusiveMaximum": "< "}
    return words + "".join(f", {sign}{value[k]:g}" for k, sign in limits.items() if k in value)


def commands_page() -> str:
    """Return the help of every command."""
    lines = ["# Commands", ""]
    for name, parser in _commands("edge", make_parser()):
        lines += [f"## `{name}`", "", "```text", parser.format_help().rstrip(), "```", ""]
    return "\n".join(lines)


def _commands(
    name: str, parser: argparse.ArgumentParser
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            shown = {choice.dest for choice in action._choices_actions}
            for verb, inner in action.choices.items():
                if verb in shown:
                    yield from _commands(f"{name} {verb}", inner)


def topics_page() -> str:
    """Return the table of topics."""
    lines = [
        "# Topics", "", "Keys are below `zenoh.prefix` (`edge`); `zenoh.topics` renames them.", "",
        "| key | type | rate, Hz | written by |", "|---|---|---|---|",
    ]  # fmt: skip
    for topic in topics.ALL:
        rate = f"{topic.rate_hz:g}" if topic.rate_hz else "on events"
        lines.append(f"| `{topic.key}` | {topic.type} | {rate} | {topic.writer} |")
    requests = ", ".join(f"`{key}`" for key in topics.REQUESTS)
    return "\n".join([*lines, "", f"Queryables, JSON in both directions: {requests}.", ""])
