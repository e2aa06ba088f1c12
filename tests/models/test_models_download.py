"""Downloads from a real server: resumed, limited, whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import resource

import pytest

from edge.models.download import DownloadLimits, download, printable_url, read_small
from edge.models.partial_file import FetchError, PartialFile
from edge.perception.runtime.model_file import ModelError

CONTENT = bytes(range(256)) * 400
SHA256 = hashlib.sha256(CONTENT).hexdigest()
LIMITS = DownloadLimits(tries=3, small_bytes=1000)


def part(tmp_path, sha256=SHA256, size=None):
    return PartialFile(tmp_path / "w.pt", sha256, size)


def left(tmp_path):
    """Return the sizes of the files in the folder, by name."""
    return {path.name: path.stat().st_size for path in tmp_path.iterdir()}


def fetch(server, tmp_path, limits=LIMITS, **expected):
    with part(tmp_path, **expected) as target:
        download(server.url("/w.pt"), target, limits)


@pytest.mark.parametrize("content", [b"", CONTENT])
def test_a_file_is_downloaded_completely(server, tmp_path, content):
    server.put("/w.pt", content)
    fetch(server, tmp_path, sha256=hashlib.sha256(content).hexdigest())
    assert (tmp_path / "w.pt").read_bytes() == content
    assert left(tmp_path) == {"w.pt": len(content)}


def test_a_broken_download_resumes_at_its_end(server, tmp_path):
    how = server.put("/w.pt", CONTENT, cut=40_000)
    fetch(server, tmp_path)
    assert [asked.get("range") for asked in how.asked] == [None, "bytes=40000-", "bytes=80000-"]
    assert (tmp_path / "w.pt").read_bytes() == CONTENT


def test_a_part_of_an_earlier_run_is_resumed(server, tmp_path):
    how = server.put("/w.pt", CONTENT, cut=30_000)
    with pytest.raises(FetchError, match=r"w\.pt: closed the connection before its answer was"):
        fetch(server, tmp_path)
    assert list(left(tmp_path).values()) == [90_000]
    how.cut = None
    fetch(server, tmp_path)
    assert how.asked[-1]["range"] == "bytes=90000-"
    assert left(tmp_path) == {"w.pt": len(CONTENT)}


def test_a_server_without_ranges_sends_the_whole_file(server, tmp_path):
    part(tmp_path).path.write_bytes(CONTENT[:5])
    server.put("/w.pt", CONTENT, ranges=False)
    fetch(server, tmp_path)
    assert (tmp_path / "w.pt").read_bytes() == CONTENT


@pytest.mark.parametrize("earlier", [b"x" * 50, b"x" * 200_000], ids=["other", "longer"])
def test_a_wrong_partial_file_is_discarded(server, tmp_path, earlier):
    part(tmp_path).path.write_bytes(earlier)
    server.put("/w.pt", CONTENT)
    fetch(server, tmp_path)
    assert left(tmp_path) == {"w.pt": len(CONTENT)}


@pytest.mark.parametrize("came", [CONTENT[:50], b"x" * 50], ids=["beginning", "other"])
def test_a_wrong_partial_file_does_not_fail_the_next_source(server, tmp_path, came):
    how = server.put("/w.pt", CONTENT)
    with part(tmp_path) as target:
        target.write(came)
        download(server.url("/w.pt"), target, LIMITS)
    assert (tmp_path / "w.pt").read_bytes() == CONTENT
    assert how.asked[0]["range"] == "bytes=50-"


def test_a_part_that_is_whole_needs_no_server(server, tmp_path):
    part(tmp_path).path.write_bytes(CONTENT)
    fetch(server, tmp_path)
    assert left(tmp_path) == {"w.pt": len(CONTENT)}


@pytest.mark.parametrize(
    ("how", "expected", "message"),
    [
        ({"content": CONTENT[::-1]}, {}, "sha256 is"),
        ({"content": CONTENT * 2}, {"size": len(CONTENT)}, "has 204800 bytes, but the model card"),
        ({"content": CONTENT[1:]}, {"size": len(CONTENT)}, "has 102399 bytes, but the model card"),
        ({"content": CONTENT, "told": 1 << 40}, {}, "has 1099511627776 bytes, over the limit"),
        ({"content": b"", "status": 404}, {}, "HTTP 404 Not Found"),
        ({"status": 302, "location": "file:///etc/passwd"}, {}, "not a valid address"),
        ({"status": 302, "location": "/w.pt"}, {}, "more than 10 redirects"),
    ],
    ids=["hash", "long", "short", "huge", "missing", "file", "loop"],
)  # fmt: skip
def test_a_wrong_file_is_refused_and_leaves_nothing(server, tmp_path, how, expected, message):
    server.put("/w.pt", **how)
    with pytest.raises(FetchError) as error:
        fetch(server, tmp_path, **expected)
    assert message in str(error.value)
    assert str(error.value).startswith(server.url("/w.pt"))
    assert "\n" not in str(error.value)
    assert left(tmp_path) == {}


def test_a_server_that_sends_more_than_announced_is_cut_off(tmp_path, server):
    server.put("/w.pt", CONTENT, told=len(CONTENT) // 2)
    with pytest.raises(FetchError, match="sha256"):
        fetch(server, tmp_path)
    assert left(tmp_path) == {}


def test_a_file_over_its_size_is_discarded(tmp_path):
    with part(tmp_path, size=10) as target:
        target.write(b"123456789")
        with pytest.raises(FetchError, match="longer than the expected 10 bytes"):
            target.write(b"10")
    assert left(tmp_path) == {}


def test_a_server_that_trickles_is_given_up(server, tmp_path):
    server.put("/w.pt", CONTENT, cut=1, stall=True)
    with pytest.raises(FetchError, match=r"only [01] bytes came in 0 s"):
        fetch(server, tmp_path, limits=DownloadLimits(slow_s=0.0, slow_bytes=2, tries=1))


def test_a_redirect_is_followed_without_the_password(server, tmp_path):
    first = server.put("/w.pt", status=302, location=server.url("/there"))
    second = server.put("/there", CONTENT)
    with part(tmp_path) as target:
        download(server.url("/w.pt", user="me:secret@"), target, LIMITS)
    assert "authorization" in first.asked[0]
    assert "authorization" not in second.asked[0]
    assert (tmp_path / "w.pt").read_bytes() == CONTENT
    assert printable_url("https://me:secret@host:8/x?y=1") == "https://host:8/x?***"


def test_two_at_one_file_do_not_mix(tmp_path):
    with part(tmp_path) as first:
        first.write(CONTENT)
        with pytest.raises(ModelError, match="another process is downloading it"), part(tmp_path):
            pass
        first.finish()
    assert (tmp_path / "w.pt").read_bytes() == CONTENT


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with (
        pytest.raises(ModelError, match="cannot be written"),
        PartialFile(tmp_path / "file" / "w", SHA256),
    ):
        pass


def test_a_pipe_instead_of_a_partial_file_is_an_error(tmp_path):
    os.mkfifo(part(tmp_path).path)
    with pytest.raises(ModelError, match=r"part: cannot be written \(Not a regular file\)"):
        part(tmp_path).__enter__()


@contextlib.contextmanager
def full_disk(limit):
    """Limit the size of every file; longer writes fail as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write_in_blocks(tmp_path):
    with part(tmp_path) as target:
        for begin in range(0, len(CONTENT), 1024):
            target.write(CONTENT[begin : begin + 1024])


def test_a_full_disk_keeps_the_part_that_fits(tmp_path):
    with full_disk(50_000), pytest.raises(ModelError, match=r"part: cannot be written \(File too"):
        write_in_blocks(tmp_path)
    with part(tmp_path) as target:
        assert target.have == 50_000
        target.write(CONTENT[target.have :])
        target.finish()
    assert left(tmp_path) == {"w.pt": len(CONTENT)}


def test_a_small_file_is_small(server):
    server.put("/said", b"x" * 1000)
    assert read_small(server.url("/said"), LIMITS) == b"x" * 1000
    server.put("/said", b"x" * 1001)
    with pytest.raises(FetchError, match="longer than 1000 bytes"):
        read_small(server.url("/said"), LIMITS)


def test_a_proxy_that_cannot_be_used_is_reported(monkeypatch, server, tmp_path):
    monkeypatch.setenv("all_proxy", "gopher://127.0.0.1:9")
    with pytest.raises(FetchError, match="the proxy in the environment variables cannot be used"):
        fetch(server, tmp_path)


def test_the_log_has_the_progress(server, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("edge.host.progress.LOG_PERIOD_S", 0.0)
    server.put("/w.pt", CONTENT)
    fetch(server, tmp_path)
    assert "w.pt: 100%|##########| 102k/102k [" in capsys.readouterr().err
