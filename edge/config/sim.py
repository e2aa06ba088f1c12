"""The simulator and its worlds."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field

from edge.config.section import NonNegative, Positive, Section


class WorldHouse(Section):
    """A house of boxes, cylinders and the like; `house` names a built-in one or a JSON file."""

    kind: Literal["house"] = "house"
    house: str = "demo"


class WorldMesh(Section):
    """A textured mesh (extra `worlds`) with its objects' boxes."""

    kind: Literal["mesh"] = "mesh"
    mesh: str
    objects: str


class WorldProcthor(Section):
    """One house of a ProcTHOR JSON-lines file, as boxes."""

    kind: Literal["procthor"] = "procthor"
    file: str
    name: str


class Sim(Section):
    world: Annotated[Union[WorldHouse, WorldMesh, WorldProcthor], Field(discriminator="kind")] = (
        WorldHouse()
    )
    start: tuple[float, float, float] | None = None
    seed: int = 0
    lockstep: bool = False
    step_s: Positive = 0.1
    depth_noise: NonNegative = 0.0
    drift_m_per_m: NonNegative = 0.0
    drift_rad_per_rad: NonNegative = 0.0
