"""Files of a Gazebo world, found by URI, and only in the folders that the user named."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.parsers import expat

from edge.host.files import read_regular
from edge.lab.sim.base import WorldError
from edge.text import one_line

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tga", ".bmp", ".tif", ".tiff", ".webp")
# Folders of textures, as seen from the folder of the mesh.
_TEXTURE_FOLDERS = (".", "../materials/textures", "../textures", "materials/textures")


class ModelFolders:
    """Folders that a world may read from, each with models as folders. No other file is read."""

    def __init__(self, folders: Iterable[Path]) -> None:
        self._folders = [folder.resolve() for folder in folders]

    def find(self, uri: str, base: Path) -> Path | None:
        """Return the file or folder of a URI; None if it is in none of the folders.

        A URI is `model://NAME/…`, `package://…`, `file://…`, a path, or the address of a model,
        which is looked up by its last part. `base` is the folder of the file that has it. Nothing
        is fetched.
        """
        scheme, _, path = unquote(uri.strip()).replace("\\", "/").rpartition("://")
        if scheme in ("http", "https"):
            path = path.rstrip("/").rpartition("/")[2]
        # Worlds write `file://models/NAME` from the folder that has `models`.
        around = [*self._folders, *(folder.parent for folder in self._folders)]
        if scheme not in ("model", "package"):
            around.insert(0, base)
        return next(self._inside(folder / path for folder in around), None)

    def find_texture(self, name: str, base: Path) -> Path | None:
        """Return the texture that a mesh or a material in the folder `base` names.

        If the path is that of another computer, or the format another one, the file's name counts.
        """
        if (found := self.find(name, base)) is not None and found.is_file():
            return found
        file = PureWindowsPath(unquote(name)).name
        stem = file.rpartition(".")[0] or file
        names = [file, *(stem + suffix for suffix in _IMAGE_SUFFIXES)]
        places = (base / folder / each for folder in _TEXTURE_FOLDERS for each in names)
        return next((path for path in self._inside(places) if path.is_file()), None)

    def find_model(self, uri: str, base: Path) -> Path | None:
        """Return the SDF file of a model, from the URI of its folder or of the file itself."""
        folder = self.find(uri, base)
        if folder is None or folder.is_file():
            return folder
        if not (folder / "model.sdf").exists():  # Fuel's cache has a folder for each version
            versions = [each for each in folder.iterdir() if each.name.isdecimal()]
            folder = max(versions, key=lambda each: int(each.name), default=folder)
        file = "model.sdf"
        if (config := next(self._inside([folder / "model.config"]), None)) is not None:
            # Published models have broken ones, too: then the usual name counts.
            with suppress(WorldError):
                files = [each.text for each in parse_xml(config).iterfind("sdf") if each.text]
                file = files[-1].strip() if files else file  # the newest version comes last
        return next(self._inside([folder / file]), None)

    def _inside(self, paths: Iterable[Path]) -> Iterator[Path]:
        """Yield those of the paths that exist and, links resolved, are in the folders."""
        for path in paths:
            try:
                real = path.resolve()
                if any(map(real.is_relative_to, self._folders)) and real.exists():
                    yield real
            except (OSError, ValueError, RuntimeError):  # no path at all, or links in a circle
                continue


def parse_xml(file: Path, content: bytes | None = None) -> ElementTree.Element:
    """Return the root element of an XML file, or of its content if that is given.

    Document types and entities are refused.

    Raises:
        WorldError: the file cannot be read, or is not such XML.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()

    def refuse(*_: object) -> None:
        raise WorldError(f"{file}: has a document type or entities; remove its <!DOCTYPE …>")

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(read_regular(file) if content is None else content, True)
        return builder.close()
    except OSError as error:
        raise WorldError(
            f"{file}: cannot be read: {error.strerror}; correct the path or its rights"
        ) from None
    except expat.ExpatError as error:
        raise WorldError(f"{file}: not XML: {one_line(error)}; correct that line") from None
