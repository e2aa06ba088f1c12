"""Names of imported objects: from the names of models, and a table that people edit."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path

from edge import names
from edge.config.yaml_text import read_yaml
from edge.errors import ConfigError
from edge.host.files import save
from edge.text import one_line

STRUCTURE = "structure"
"""Name in the table of what is the building, and no object."""
_STRUCTURE_WORDS = frozenset({
    "ceiling", "floor", "ground", "ground plane", "light", "roof", "sun", "wall",
})  # fmt: skip
# Words in front of names: makers, collections, kinds of buildings.
_VENDOR_WORDS = frozenset({
    "aws", "gazebo", "gz", "hospital", "ign", "model", "openrobotics", "osrf", "residential",
    "retail", "robomaker", "warehouse",
})  # fmt: skip
_HEAD = """\
# Names of the models, as a robot is asked for them. Change them, then run the same command again.
# `structure` is the building: walls, floors, ceilings, lights.
"""


def object_name(model: str) -> str:
    """Return the name of a model's object, or `structure`.

    >>> object_name("aws_robomaker_residential_Sofa_01"), object_name("InstrumentCart1")
    ('sofa', 'instrument cart')
    >>> object_name("aws_robomaker_hospital_floor_01_walls"), object_name("CoffeeTable_2")
    ('structure', 'coffee table')
    """
    text = re.sub(r"[_\s]*\d+", " ", model[: names.MAX_CHARS]).strip()
    words = names.normalise(text).split() if names.is_name(text) else []
    while len(words) > 1 and words[0] in _VENDOR_WORDS:
        del words[0]
    endings = [" ".join(words[start:]) for start in range(len(words))]
    if any(names.singular(ending) in _STRUCTURE_WORDS for ending in endings):
        return STRUCTURE
    known = next(filter(names.is_known, endings), None)
    return names.canonical(known or endings[0]) if endings else STRUCTURE


def read_names(path: Path) -> dict[str, str]:
    """Return the name of each model of a table; an empty one if there is no table yet.

    Raises:
        ConfigError: the table is no table, or has a text that is no name.
    """
    if not path.exists():
        return {}
    table = read_yaml(path) or {}
    if not isinstance(table, dict):
        raise ConfigError(f"{path}: expected lines `MODEL: name`; correct it, or remove the file")
    for model, name in table.items():
        if not names.is_name(str(name)):
            raise ConfigError(
                f"{path}: {one_line(model)}: {one_line(name)!r:.80} is no name; write one such as "
                "sofa, or structure"
            )
    return {str(model): names.canonical(str(name)) for model, name in table.items()}


def save_names(path: Path, table: Iterable[tuple[str, str]]) -> None:
    """Write the table of names, in their order."""
    # JSON's strings are YAML, too.
    lines = (f"{json.dumps(model)}: {json.dumps(name)}\n" for model, name in sorted(table))
    save(path, (_HEAD + "".join(lines)).encode())
