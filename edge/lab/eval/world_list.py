"""Parses the `--worlds` of an evaluation, and caches the worlds that were loaded last."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

from edge.config import Config, parse
from edge.errors import UserError
from edge.host import resources
from edge.lab.eval.arms import data_of, merged
from edge.lab.sim.base import World
from edge.lab.sim.procthor import read_houses
from edge.lab.sim.worlds import load_world

WorldSection = dict[str, Any]
"""Value of `sim.world` in a configuration."""

WORLD_FORMS = (
    "FILE.jsonl.gz[0:75], generated[1000:1050], furnished[1000:1050], "
    "furnished:FILE.jsonl.gz[0:75], house:NAME, MESH.glb,OBJECTS.json"
)
# "generated[1000:1050]": name "generated", first 1000, end 1050. "h.jsonl.gz[3]": no `to`, no end.
# Without brackets, only the name.
_SPEC = re.compile(r"^(?P<name>.+?)(?:\[(?P<first>\d*)(?P<to>:(?P<end>\d*))?\])?$")
_FURNISHED = "furnished"
_MAX_SEEDS = 100_000
_KEPT_WORLDS = 2  # in the cache


def world_sections(specs: Sequence[str]) -> list[WorldSection]:
    """Return a section `sim.world` for each world that `--worlds` lists, in the same order.

    Each spec has a form of `WORLD_FORMS`: houses of a ProcTHOR file by position, generated houses
    by seed, both also with textured furniture, a built-in house or a house's file, or a mesh with
    its objects.
    """
    return [section for spec in specs for section in _sections_of(spec, spec)]


def _sections_of(form: str, spec: str) -> list[WorldSection]:
    """Return the sections of a form. Errors name `spec`, the text that the user gave."""
    if form.startswith((f"{_FURNISHED}[", f"{_FURNISHED}:")):
        plain = form.removeprefix(_FURNISHED)
        houses = _sections_of(plain[1:] if plain[0] == ":" else f"generated{plain}", spec)
        # A generated house and its furniture have the same seed.
        return [
            {"kind": "furnished", "house": house, "seed": house.get("seed", 0)} for house in houses
        ]
    matched = _SPEC.match(form)
    name, ranged = matched["name"], matched["first"] is not None
    if name.endswith((".jsonl", ".jsonl.gz")):
        houses = [house.get("name") for house in read_houses(resources.expand(name))]
        chosen = [houses[k] for k in _range(spec, matched, len(houses)) if k < len(houses)]
        if not chosen:
            raise UserError(
                f"--worlds {spec}: no house in this range; {name} has houses 0 to {len(houses) - 1}"
            )
        return [{"kind": "procthor", "file": name, "name": house} for house in chosen]
    if name == "generated" and ranged:
        seeds = _range(spec, matched, None)
        return [{"kind": "generated", "seed": seed} for seed in seeds]
    built_in, colon, house = name.partition(":")
    if (built_in, colon) == ("house", ":") and house and not ranged:
        return [{"kind": "house", "house": house}]
    mesh, comma, objects = name.partition(",")
    if comma and objects and not ranged:
        return [{"kind": "mesh", "mesh": mesh, "objects": objects}]
    raise UserError(f"--worlds {spec}: no such world; give one of these forms: {WORLD_FORMS}")


def _range(spec: str, matched: re.Match[str], length: int | None) -> range:
    """Return the numbers of `[first:end]` or `[number]`; without brackets, all up to `length`."""
    if matched["first"] is None:
        return range(length or 0)
    first = int(matched["first"] or 0)
    end = first + 1 if matched["to"] is None else int(matched["end"] or length or 0)
    if end <= first:
        raise UserError(f"--worlds {spec}: no world; END must be greater than FIRST in [FIRST:END]")
    if end - first > _MAX_SEEDS:
        raise UserError(f"--worlds {spec}: {end - first} worlds; at most {_MAX_SEEDS} are allowed")
    return range(first, end)


def worlds(config: Config, specs: Sequence[str]) -> Iterator[tuple[Config, World]]:
    """Yield the configuration and the world of each place that `--worlds` lists; see `load`."""
    for section in world_sections(specs):
        in_world = parse(merged(data_of(config), {"sim": {"world": section}}), config.path)
        yield in_world, load(in_world)


def load(config: Config) -> World:
    """Load the world of a configuration. The last ones stay in memory."""
    # All that a world depends on: its file, and also the robot's height and the camera's depths.
    cache_key = config.model_dump(mode="json", include={"robot", "sensors", "sim", "perception"})
    cache_key["sim"] = {"world": cache_key["sim"]["world"]}
    cache_key["perception"] = {"detector": {"kind": "sim"}}  # any valid one: worlds do not use it
    return _load_cached(json.dumps(cache_key, sort_keys=True), config.path)


@lru_cache(maxsize=_KEPT_WORLDS)
def _load_cached(cache_key: str, path: str) -> World:
    return load_world(parse(json.loads(cache_key), path))
