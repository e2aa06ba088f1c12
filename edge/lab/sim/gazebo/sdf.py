"""Reads an SDF world with all models that it includes: its visuals, each at its place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, fromstring

import numpy as np

from edge.geometry import se3, se3_from_quaternion
from edge.lab.sim.base import WorldError
from edge.lab.sim.gazebo.folders import ModelFolders, parse_xml
from edge.text import one_line

_MAX_DEPTH = 16  # of models in models, and of frames that refer to frames
_MAX_VISUALS = 50_000
# Models that Gazebo itself brings.
_BUILT_IN = {
    "model://sun": "<model/>",
    "model://ground_plane": "<model><link><visual><geometry><plane><size>100 100</size></plane>"
    "</geometry></visual></link></model>",
}
_IGNORED = ("actor", "population", "road")  # elements that have a shape, but are not read


class ModelVisual(NamedTuple):
    """A visual at its place.

    Attributes:
        instance: name of the placed model, unique in the world but for its parts.
        model: name of the model that was placed, such as `aws_robomaker_residential_Sofa_01`.
        T_world_visual: (4, 4) pose.
        material: its element, or None.
    """

    instance: str
    model: str
    name: str
    T_world_visual: np.ndarray
    geometry: Element
    material: Element | None
    file: Path


class SdfReader:
    """Reads one world.

    Attributes:
        problems: one line for each part that was left out, and how often it was.
    """

    def __init__(self, folders: ModelFolders) -> None:
        self.problems: Counter[str] = Counter()
        self._folders = folders
        self._parse = cache(parse_xml)
        self._count = 0

    def read(self, world: Path) -> list[ModelVisual]:
        """Return the visuals of a world file, or of a model file."""
        root = self._parse(world)
        scope = root if root.find("world") is None else root.find("world")
        assert scope is not None
        # A world that Gazebo saved has the places to which models were moved.
        moved = {model.get("name", ""): model for model in scope.iterfind("state/model")}
        return list(self._scope(scope, np.eye(4), world, None, moved))

    def _scope(
        self,
        scope: Element,
        T_world_scope: np.ndarray,
        file: Path,
        names: tuple[str, str] | None,
        moved: dict[str, Element],
        depth: int = 0,
    ) -> Iterator[ModelVisual]:
        """Yield the visuals of a world or model.

        Args:
            scope: its element.
            T_world_scope: (4, 4) its pose.
            file: the file that has the element.
            names: instance and model, see `ModelVisual`; None for a world.
            moved: the elements that replace the poses of its models, by name.
            depth: number of models around it.
        """
        nested = [each for each in scope if each.tag in ("model", "include")]
        # A model that only wraps another one gives its name to it.
        wraps = names is not None and len(nested) == 1 and scope.find("link") is None
        for element in scope:
            where = f"{file}: {_label(element)}"
            try:
                if element.tag == "link" and names is not None:
                    yield from self._link(scope, element, T_world_scope, file, names)
                elif element.tag in _IGNORED:
                    raise WorldError(f"{where}: left out: such elements cannot be imported")
                elif element in nested:
                    own = moved.get(_name(element), element)
                    inner, inner_file, model = element, file, _name(element)
                    if element.tag == "include":
                        inner, inner_file, model = self._include(element, file, where)
                        own = moved.get(_name(element), element)
                        own = inner if own.find("pose") is None else own
                    if depth >= _MAX_DEPTH:
                        raise WorldError(f"{where}: models nested too deeply; remove a circle")
                    name = _name(element) or model
                    if names is not None:
                        name = names[0] if wraps else f"{names[0]}-{name}"
                    T = T_world_scope @ _pose_in(scope, own)
                    yield from self._scope(inner, T, inner_file, (name, model), {}, depth + 1)
            except WorldError as error:
                if self._count > _MAX_VISUALS:
                    raise
                self.problems[str(error)] += 1

    def _include(self, element: Element, file: Path, where: str) -> tuple[Element, Path, str]:
        """Return the included model's element, its file and its name."""
        uri = (element.findtext("uri") or "").strip()
        path = self._folders.find_model(uri, file.parent)
        if path is None:
            if uri in _BUILT_IN:
                return fromstring(_BUILT_IN[uri]), file, uri.rpartition("/")[2]
            raise WorldError(
                f"{where}: model {one_line(uri)} is in no model folder; add its folder with "
                "--models"
            )
        model = self._parse(path).find("model")
        if model is None:
            raise WorldError(f"{path}: has no <model>; correct the file")
        name = path.parent.parent.name if path.parent.name.isdecimal() else path.parent.name
        return model, path, name

    def _link(
        self,
        scope: Element,
        link: Element,
        T_world_scope: np.ndarray,
        file: Path,
        names: tuple[str, str],
    ) -> Iterator[ModelVisual]:
        """Yield the visuals of a link."""
        T_world_link = T_world_scope @ _pose_in(scope, link)
        for visual in link.iterfind("visual"):
            self._count += 1
            if self._count > _MAX_VISUALS:
                raise WorldError(f"{file}: more than {_MAX_VISUALS} visuals; import a part of it")
            geometry = visual.find("geometry")
            if geometry is None or not len(geometry) or geometry[0].tag == "empty":
                continue
            # Without a named frame, a visual's pose is relative to the link.
            T = T_world_scope if _frame_name(visual) else T_world_link
            yield ModelVisual(
                *names, _name(visual), T @ _pose_in(scope, visual), geometry[0],
                visual.find("material"), file,
            )  # fmt: skip


def _name(element: Element) -> str:
    return one_line(element.get("name") or element.findtext("name") or "").strip()


def _label(element: Element) -> str:
    """Return tag and name of an element, for messages."""
    name = _name(element)
    return f"<{element.tag}> {name!r}" if name else f"<{element.tag}>"


def _reference(element: Element) -> str | None:
    """Return the frame that an element's pose is relative to; None for the default."""
    name = _frame_name(element)
    if not name and element.tag == "frame":
        name = element.get("attached_to")
    return name if name and name not in ("__model__", "world") else None


def _frame_name(element: Element) -> str | None:
    """Return the frame that an element's `<pose>` names; None or "" for none."""
    pose = element.find("pose")
    return None if pose is None else pose.get("relative_to") or pose.get("frame")


def _pose_in(scope: Element, element: Element, depth: int = 0) -> np.ndarray:
    """Return the (4, 4) pose of an element of a world or model, relative to that."""
    T, name = _matrix(element), _reference(element)
    if name is None:
        return T
    frame = next((each for each in scope if each.tag != "joint" and _name(each) == name), None)
    if frame is None or depth >= _MAX_DEPTH:
        raise WorldError(
            f"{_label(element)}: its pose is relative to {one_line(name)!r}, "
            "which is no link, model or frame next to it; give the pose in the model's frame"
        )
    return _pose_in(scope, frame, depth + 1) @ T


def _matrix(element: Element) -> np.ndarray:
    """Return an element's `<pose>` as a (4, 4) matrix; without one, the identity."""
    pose = element.find("pose")
    if pose is None or not (pose.text or "").strip():
        return np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        x, y, z, *quaternion = numbers(element, "pose", 7)
        if np.linalg.norm(quaternion) < 1e-3:
            raise WorldError(f"{_label(element)}: <pose>: the quaternion is zero; correct it")
        return se3_from_quaternion((x, y, z), tuple(quaternion))
    x, y, z, *angles = numbers(element, "pose", 6)
    return se3(x, y, z, *(np.radians(angles) if pose.get("degrees") == "true" else angles))


def numbers(element: Element, tag: str, count: int, default: str | None = None) -> np.ndarray:
    """Return the numbers in an element's child.

    Raises:
        WorldError: the child is missing and there is no default, or it has not `count` finite
            numbers.
    """
    text = element.findtext(tag)
    text = default if text is None else text
    try:
        values = np.array((text or "").split(), float)
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        raise WorldError(
            f"{_label(element)}: <{tag}> is {one_line(text or '')!r:.80}; "
            f"expected {count} numbers below a million"
        )
    return values
