"""Zenoh's own file under our settings, and the errors of an unusable one."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from secure_files import page_commands

from edge.bus import zenoh_file
from edge.bus.session import BusError, open_session, session_config
from edge.bus.zenoh_file import (
    certificates,
    denies_prefix,
    exposed_secrets,
    get,
    open_addresses,
    secrets,
)
from edge.config import ConfigError, ZenohConfig, parse
from edge.host.credentials import COPIES
from edge.host.resources import data_dir

OURS = "tcp/127.0.0.1:17447"
SECURE = data_dir("config") / "secure"


@pytest.fixture
def settings(tmp_path):
    def with_file(text: str, **more: object) -> ZenohConfig:
        path = tmp_path / "zenoh.json5"
        path.write_text(text)
        return ZenohConfig(**{"endpoint": OURS, "file": str(path), **more})

    return with_file


def of(settings: ZenohConfig, role: str, key: str) -> object:
    return get(session_config(settings, role), key)


@pytest.mark.parametrize(
    ("role", "more", "listens", "connects"),
    [
        ("listen", {}, [OURS, "tcp/[::]:1"], ["tcp/router:2"]),
        ("connect", {}, [], [OURS, "tcp/router:2"]),
        ("listen", {"mode": "client"}, [], [OURS, "tcp/router:2"]),
    ],
)
def test_endpoints_add_up(settings, role, more, listens, connects):
    said = settings(
        '{listen: {endpoints: ["tcp/[::]:1"]}, connect: {endpoints: ["tcp/router:2"]}}', **more
    )
    assert of(said, role, "listen/endpoints") == listens
    assert of(said, role, "connect/endpoints") == connects


@pytest.mark.parametrize("key", zenoh_file.DEFAULTS)
def test_the_zenoh_file_overrides_our_defaults(settings, key):
    ours = zenoh_file.DEFAULTS[key]
    theirs = not ours if isinstance(ours, bool) else ours + 1
    text = json.dumps(theirs)
    for part in reversed(key.split("/")):
        text = f"{{{part}: {text}}}"
    assert of(settings(text), "listen", key) == theirs
    assert of(settings("{}"), "listen", key) == ours


@pytest.mark.parametrize(
    ("text", "role", "mode", "stamps"),
    [
        # A publisher that keeps its last message, as a ROS 2 node's for its map, wants stamps.
        ("{}", "connect", "peer", True),
        ("{}", "listen", "client", True),
        ("{}", "listen", "peer", False),
        ("{timestamping: {enabled: true}}", "listen", "peer", True),
        ("{timestamping: {enabled: false}}", "connect", "peer", False),
    ],
)
def test_clients_add_timestamps_unless_the_file_decides(settings, text, role, mode, stamps):
    assert of(settings(text, mode=mode), role, "timestamping/enabled") is stamps


@pytest.mark.parametrize(("here", "there"), [(True, False), (False, True), (True, True)])
def test_shared_memory_needs_both_the_key_and_the_file(settings, here, there):
    said = settings(
        f"{{transport: {{shared_memory: {{enabled: {json.dumps(there)}}}}}}}", shared_memory=here
    )
    assert of(said, "listen", "transport/shared_memory/enabled") is (here and there)


def test_places_for_connections_stay_below_the_descriptors_of_a_process():
    assert zenoh_file.PENDING + zenoh_file.SESSIONS < 1024 - 256


@pytest.mark.parametrize(
    ("endpoint", "listens"),
    [
        ("tls/h:1", "tls/h:1#tls_handshake_timeout_ms=2000"),
        ("tls/h:1#so_rcvbuf=9", "tls/h:1#so_rcvbuf=9;tls_handshake_timeout_ms=2000"),
        ("tls/h:1#tls_handshake_timeout_ms=7", "tls/h:1#tls_handshake_timeout_ms=7"),
    ],
)
def test_a_tls_handshake_ends_in_time(endpoint, listens):
    assert of(ZenohConfig(endpoint=endpoint), "listen", "listen/endpoints") == [listens]
    assert of(ZenohConfig(endpoint=endpoint), "connect", "connect/endpoints") == [endpoint]


def test_the_client_file_overrides_the_file_of_the_service(settings, tmp_path):
    own = tmp_path / "client.json5"
    own.write_text('{namespace: "of/the/client"}')
    said = settings('{namespace: "of/the/service"}')
    assert of(said, "connect", "namespace") == "of/the/service"
    said = said.model_copy(update={"client_file": str(own)})
    assert of(said, "connect", "namespace") == "of/the/client"
    assert of(said, "listen", "namespace") == "of/the/service"


PASSWORD = '{transport: {auth: {usrpwd: {user: "me", password: "SENTINEL"%s}}}}'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "Empty config file"),
        ("{ a", "line 1, column 1: expected array, boolean"),
        ("{nonsense: 1}", "line 1, column 2: unknown field `nonsense`, expected one of `id`"),
        ('{mode: "SENTINEL"}', "line 1, column 8: unknown variant, expected one of `router`"),
        ('{queries_default_timeout: "SENTINEL"}', "line 1, column 27: "),
        ('{scouting: {multicast: {enabled: "SENTINEL"}}}', "invalid type: string, expected"),
        (PASSWORD.replace('"SENTINEL"%s', "4242"), "invalid type: integer, expected a string"),
        (PASSWORD % ", dictionary_file: 4242", "invalid type"),
        (PASSWORD % " oops", "expected"),
        (PASSWORD % "" + '\n"SENTINEL"', "line 2, column 1: expected"),
        ('{mode: "router"}', "mode is 'router', but edge sets 'peer' here: remove mode from this"),
        (
            '{connect: {endpoints: ["tls/h:1#connect_private_key_base64=SENTINEL"]}}',
            "an endpoint has a private key (private_key_base64): move the key to transport/link",
        ),
    ],
)
def test_an_unusable_file_is_refused_without_its_secrets(settings, text, says):
    said = settings(text)
    with pytest.raises(ConfigError) as caught:
        session_config(said, "listen")
    line = str(caught.value)
    assert line.startswith(f"zenoh.file: {said.file}: ")
    assert says in line
    assert "\n" not in line
    assert "SENTINEL" not in line
    assert "4242" not in line


@pytest.mark.parametrize("key", ["file", "client_file"])
def test_a_missing_file_is_named(key, tmp_path):
    settings = ZenohConfig(**{key: str(tmp_path / "gone.json5")})
    with pytest.raises(ConfigError, match=rf"^zenoh\.{key}: .*gone\.json5: no such file$"):
        session_config(settings, "listen" if key == "file" else "connect")


def test_a_private_key_in_the_endpoint_is_refused_and_not_shown():
    endpoint = "tls/h:1#listen_private_key_base64=SENTINEL"
    with pytest.raises(ConfigError, match=r"put the key into Zenoh") as caught:
        parse({"zenoh": {"endpoint": endpoint}, "perception": {"detector": {"kind": "sim"}}})
    assert "SENTINEL" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{transport: {link: {tls: {listen_private_key: "/gone.key"}}}}', "/gone.key: no such"),
        ('{transport: {auth: {usrpwd: {dictionary_file: "/gone"}}}}', "/gone: no such"),
        ("{access_control: {enabled: true}}", "ACL rules/subjects/policies"),
    ],
)
def test_the_error_names_the_missing_part_in_one_line(settings, text, says):
    with pytest.raises(BusError) as caught:
        open_session(settings(text, endpoint="tls/127.0.0.1:0"), "listen")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


OPEN_TCP = "tcp/0.0.0.0:7447"
MUTUAL = "{transport: {link: {tls: {enable_mtls: true}}}}"
USERS = '{transport: {auth: {usrpwd: {dictionary_file: "users.txt"}}}}'


@pytest.mark.parametrize(
    ("endpoint", "text", "open_"),
    [
        ("tcp/127.0.0.1:7447", "{}", []),
        ("tcp/[::1]:7447", "{}", []),
        ("tcp/localhost:7447", "{}", []),
        ("unixsock-stream//run/edge.sock", "{}", []),
        (OPEN_TCP, "{}", [OPEN_TCP]),
        ("tcp/robot:7447", "{}", ["tcp/robot:7447"]),
        ("tls/0.0.0.0:7447", "{}", ["tls/0.0.0.0:7447"]),
        ("tls/0.0.0.0:7447", MUTUAL, []),
        (OPEN_TCP, MUTUAL, [OPEN_TCP]),  # certificates are for TLS alone
        (OPEN_TCP, USERS, []),
        ("tls/0.0.0.0:7447#enable_mtls=true", "{}", []),
        ("tls/0.0.0.0:7447#enable_mtls=false", MUTUAL, ["tls/0.0.0.0:7447"]),
        (OURS, f'{{listen: {{endpoints: ["{OPEN_TCP}"]}}}}', [OPEN_TCP]),
    ],
)
def test_endpoints_open_to_any_client_are_listed(settings, endpoint, text, open_):
    assert open_addresses(session_config(settings(text, endpoint=endpoint), "listen")) == open_


KEYS = """{transport: {
  link: {tls: {listen_private_key: "{at}/service.key", listen_certificate: "{at}/service.crt"}},
  auth: {usrpwd: {dictionary_file: "{at}/users.txt"}},
}}"""


def secret_paths(settings: ZenohConfig, role: str = "listen") -> list[str]:
    return exposed_secrets(session_config(settings, role), "zenoh.file", settings.file)


def test_secrets_readable_by_others_are_listed(settings, tmp_path):
    for name in ("service.key", "users.txt"):
        (tmp_path / name).touch(0o600)
    (tmp_path / "service.crt").touch(0o644)
    said = settings(KEYS.replace("{at}", str(tmp_path)))
    assert secret_paths(said) == []
    (tmp_path / "users.txt").chmod(0o604)
    assert secret_paths(said) == [str(tmp_path / "users.txt")]


@pytest.mark.parametrize(
    "text", [PASSWORD % "", '{transport: {link: {tls: {connect_private_key_base64: "SENTINEL"}}}}']
)
def test_a_file_that_contains_a_secret_counts_as_one(settings, text):
    said = settings(text)
    os.chmod(said.file, 0o604)
    assert secret_paths(said, "connect") == [said.file]
    os.chmod(said.file, 0o600)
    assert secret_paths(said, "connect") == []


def test_credentials_of_the_service_manager_replace_the_files(settings, tmp_path, monkeypatch):
    said = settings(KEYS.replace("{at}", "/root/only"))
    copies = tmp_path / "copies"
    copies.mkdir()
    (copies / "listen_private_key").touch()
    monkeypatch.setenv(COPIES, str(copies))
    found = session_config(said, "listen")
    assert secrets(found, "zenoh.file", said.file) == {
        "listen_private_key": str(copies / "listen_private_key"),
        "dictionary_file": "/root/only/users.txt",
    }
    assert certificates(found) == ["/root/only/service.crt"]
    (copies / "zenoh.file.json5").write_text('{namespace: "of/the/copy"}')
    assert of(said, "listen", "namespace") == "of/the/copy"


RULES = """{access_control: {enabled: %s, default_permission: "%s", rules: [
  {id: "a", permission: "%s", flows: ["ingress"], messages: ["put"], key_exprs: ["edge/*", "x"]},
], subjects: [{id: "all"}], policies: [{subjects: ["all"], rules: ["a"]}]}}"""


@pytest.mark.parametrize(
    ("text", "prefix", "shut"),
    [
        ("{}", "edge", False),
        (RULES % ("true", "deny", "allow"), "edge", False),
        (RULES % ("true", "deny", "allow"), "robots/a", True),
        (RULES % ("true", "deny", "deny"), "edge", True),
        (RULES % ("true", "allow", "deny"), "robots/a", False),
        (RULES % ("false", "deny", "allow"), "robots/a", False),
    ],
)
def test_rules_for_another_prefix_are_noticed(settings, text, prefix, shut, caplog):
    said = settings(text, prefix=prefix, endpoint="tcp/127.0.0.1:0")
    assert denies_prefix(session_config(said, "listen"), prefix) is shut
    open_session(said, "listen").close()
    assert (f"no key below {prefix}/" in caplog.text) is shut


def test_the_page_makes_the_service_with_passwords_of_the_one_with_certificates(tmp_path):
    page_commands(tmp_path, "cp config/secure", "sed -e")
    certificates, passwords = (
        session_config(ZenohConfig(endpoint=OURS, file=str(tmp_path / f"{name}.json5")), "listen")
        for name in ("service", "password-service")
    )
    rules, same = get(certificates, "access_control"), get(passwords, "access_control")
    assert (same["rules"], same["policies"]) == (rules["rules"], rules["policies"])
    assert same["default_permission"] == rules["default_permission"] == "deny"
    assert {"id": "operator", "usernames": ["operator"]}.items() <= same["subjects"][4].items()
    assert get(passwords, "transport")["auth"]["usrpwd"]["dictionary_file"] is not None


@pytest.mark.parametrize("path", sorted(SECURE.glob("*.json5")), ids=lambda path: path.name)
def test_every_ready_file_is_understood(path: Path):
    role = "listen" if "service" in path.name else "connect"
    session_config(ZenohConfig(endpoint=OURS, file=str(path)), role)
