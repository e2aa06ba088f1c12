"""The section of the simulator and its worlds."""

from __future__ import annotations

from typing import Annotated, Literal, Union

from pydantic import Field

from edge.config.section import NonNegative, Positive, Section


class WorldHouse(Section):
    """A house of simple shapes, such as boxes and cylinders (docs/worlds.md).

    Attributes:
        house: name of a built-in house, or a JSON file.
    """

    kind: Literal["house"] = "house"
    house: str = "demo"


class WorldMesh(Section):
    """A textured mesh (extra `worlds`; docs/worlds.md).

    Attributes:
        mesh: file of the mesh, z up, in metres.
        objects: JSON file with names and boxes of its objects.
    """

    kind: Literal["mesh"] = "mesh"
    mesh: str
    objects: str


class WorldProcthor(Section):
    """A ProcTHOR house, as boxes (docs/worlds.md).

    Attributes:
        file: JSON-lines file of houses (.jsonl or .jsonl.gz).
        name: name of the house in the file.
    """

    kind: Literal["procthor"] = "procthor"
    file: str
    name: str


class WorldGenerated(Section):
    """A generated house of 4 to 10 furnished rooms.

    Attributes:
        seed: number of the house. Seeds from 1000 on are for evaluation only.
    """

    kind: Literal["generated"] = "generated"
    seed: Annotated[int, Field(ge=0)] = 0


class WorldFurnished(Section):
    """A generated or ProcTHOR house with textured furniture (extra `worlds`; docs/worlds.md).

    Attributes:
        house: the house whose walls and places for furniture are used.
        seed: number of the choice of furniture and light. Seeds from 1000 on are for evaluation
            only.
        catalogue: folder with furniture catalogues of Sweet Home 3D (.sh3f).
    """

    kind: Literal["furnished"] = "furnished"
    house: Annotated[Union[WorldGenerated, WorldProcthor], Field(discriminator="kind")] = (
        WorldGenerated()
    )
    seed: Annotated[int, Field(ge=0)] = 0
    catalogue: str = "/usr/share/sweethome3d/furniture"


class WorldStreet(Section):
    """A generated street with houses, cars, trees, poles, bins and benches.

    Attributes:
        seed: number of the street.
    """

    kind: Literal["street"] = "street"
    seed: Annotated[int, Field(ge=0)] = 0


class SimConfig(Section):
    """The simulator.

    Attributes:
        start: start pose (x in m, y in m, yaw in rad); null: that of the world.
        seed: seed of the noise.
        lockstep: true: simulated time. The simulator takes the next step when the service has
            processed the last one. Set `loop.lockstep`, too, for reproducible runs.
        step_s: simulated time of a step in lockstep.
        depth_noise: standard deviation of depth at 1 m, in m; it grows with depth squared.
        drift_m_per_m: standard deviation of the odometry's scale error of distance (0.01: 1 cm
            per m).
        drift_rad_per_rad: standard deviation of the odometry's scale error of turns.
        people: number of people who walk or stand in the world; their walks depend on `seed`.
        doors: share of a house's doorways that have a door which opens and closes; 0 to 1.
    """

    world: Annotated[
        Union[WorldHouse, WorldMesh, WorldProcthor, WorldGenerated, WorldFurnished, WorldStreet],
        Field(discriminator="kind"),
    ] = WorldHouse()
    start: tuple[float, float, float] | None = None
    seed: int = 0
    lockstep: bool = False
    step_s: Positive = 0.1
    depth_noise: NonNegative = 0.0
    drift_m_per_m: NonNegative = 0.0
    drift_rad_per_rad: NonNegative = 0.0
    people: Annotated[int, Field(ge=0, le=50)] = 0
    doors: Annotated[float, Field(ge=0, le=1)] = 0.0
