"""Files are read at once and written whole, or not at all; other paths are an error of one line."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated import simulated

from edge import config
from edge.config import WorldHouse, WorldProcthor
from edge.errors import FileError, UserError
from edge.host import checkpoint, files
from edge.host.files import read_regular, replace_atomically, write_atomically
from edge.lab.bench.frames import from_folder
from edge.lab.eval.translation_cases import lang2ltl_cases
from edge.lab.sim.house import load_house
from edge.lab.sim.mesh import read_objects
from edge.lab.sim.procthor import load_procthor
from edge.mission.checkpoint import MISSION
from edge.models.local import extract_from_wheel
from edge.models.make import store_vocabulary
from edge.perception.embedding.text import TextEmbeddings
from edge.perception.runtime.cards import read_card
from edge.sources import recording
from exporters.files import ExportError, check_sha256
from exporters.images import load_input, load_text_embeddings

pytestmark = pytest.mark.timeout(60)  # opening a pipe without a writer never ends


def make_pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder / "none", "No such file"),
        (lambda folder: folder, "Is a directory"),
        (lambda folder: make_pipe(folder / "pipe"), "Not a regular file"),
        (lambda folder: Path("/dev/zero"), "Not a regular file"),
        (lambda folder: write(folder / "long", b"x" * 101), "Longer than 100 bytes"),
    ],
    ids=["missing", "folder", "pipe", "device", "long"],
)
def test_a_path_that_is_not_a_file_fails_at_once(tmp_path, make, message):
    with pytest.raises(OSError, match=message) as caught:
        read_regular(make(tmp_path), 100)
    assert caught.value.strerror.startswith(message)


def write(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


DEFAULTS = simulated()

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "configuration": ("c.yaml", lambda path: config.load(str(path))),
    "card": ("c.yaml", read_card),
    "vocabulary": ("v.npz", lambda path: TextEmbeddings(str(path))),
    "vocabulary to keep": ("v.npz", store_vocabulary),
    "house": ("h.json", lambda path: load_house(WorldHouse(house=str(path)), DEFAULTS)),
    "houses": (
        "h.jsonl",
        lambda path: load_procthor(WorldProcthor(file=str(path), name="x"), DEFAULTS),
    ),
    "packed houses": (
        "h.jsonl.gz",
        lambda path: load_procthor(WorldProcthor(file=str(path), name="x"), DEFAULTS),
    ),
    "objects of a mesh": ("o.json", read_objects),
    "recording": ("r.mcap", lambda path: list(recording.read(path))),
    "utterances": ("u.csv", lang2ltl_cases),
    "checkpoint": ("c.json", lambda path: checkpoint.load(path, MISSION)),
    "pictures": ("p.png", lambda path: from_folder(path.parent, 1)),
    "wheel": ("a-1-py3-none-any.whl", lambda path: extract_from_wheel(path, "w.pt", None)),
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_instead_of_a_file_fails_in_one_line(tmp_path, monkeypatch, name):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    file, read = READERS[name]
    (tmp_path / "a").mkdir()
    path = make_pipe(tmp_path / "a" / file)
    with pytest.raises(UserError) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "read",
    [lambda path: load_input(path, (32, 32)), load_text_embeddings, lambda p: check_sha256(p, "0")],
    ids=["picture", "vocabulary", "weights"],
)
def test_exporters_wait_for_no_pipe_either(tmp_path, read):
    path = make_pipe(tmp_path / "pipe.png")
    with pytest.raises(ExportError) as caught:
        read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("beside", [None, ".half"])
def test_a_file_is_replaced_atomically(tmp_path, beside):
    folder = tmp_path / "new"
    file = folder / "model.onnx"
    write_atomically(file, b"old")

    def fail_halfway() -> None:
        with replace_atomically(file, beside and folder / beside) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_halfway()
    assert file.read_text() == "old"
    with replace_atomically(file, beside and folder / beside) as temporary:
        temporary.write_text("new")
    assert [path.read_text() for path in folder.iterdir()] == ["new"]
    assert file.stat().st_mode & 0o444 == 0o444


def test_an_error_without_a_number_has_its_reason(tmp_path, monkeypatch):
    def fail(path, content):
        raise OSError("no room")

    monkeypatch.setattr(files, "write_atomically", fail)
    with pytest.raises(FileError, match=r"a: cannot be written: no room$"):
        files.save(tmp_path / "a", b"")
