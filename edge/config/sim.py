"""The simulator and its worlds."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field

from edge.config.section import NonNegative, Positive, Section


class WorldHouse(Section):
    """A house of boxes, cylinders and the like; `house` names a built-in one or a JSON file.

    docs/worlds.md describes the files of all kinds.
    """

    kind: Literal["house"] = "house"
    house: str = "demo"


class WorldMesh(Section):
    """A textured mesh (extra `worlds`), z up and in metres, with a list of its objects' boxes."""

    kind: Literal["mesh"] = "mesh"
    mesh: str
    objects: str


class WorldProcthor(Section):
    """One house, by its `name`, of a JSON-lines file (.jsonl or .jsonl.gz), as boxes."""

    kind: Literal["procthor"] = "procthor"
    file: str
    name: str


class WorldGenerated(Section):
    """A furnished house of 4 to 10 rooms, another one for every seed; from 1000 on they are for
    evaluation only."""

    kind: Literal["generated"] = "generated"
    seed: Annotated[int, Field(ge=0)] = 0


class WorldStreet(Section):
    """A street with houses, cars, trees, poles, bins and benches, another one for every seed."""

    kind: Literal["street"] = "street"
    seed: Annotated[int, Field(ge=0)] = 0


class Sim(Section):
    """`start` (x and y in metres, yaw in radians) takes the place of the world's own."""

    world: Annotated[
        Union[WorldHouse, WorldMesh, WorldProcthor, WorldGenerated, WorldStreet],
        Field(discriminator="kind"),
    ] = WorldHouse()
    start: tuple[float, float, float] | None = None
    seed: int = 0
    lockstep: bool = False
    step_s: Positive = 0.1
    depth_noise: NonNegative = 0.0
    drift_m_per_m: NonNegative = 0.0
    drift_rad_per_rad: NonNegative = 0.0
