"""Zenoh's own configuration file, and the settings with which `edge` changes it.

TLS, users, access control and other Zenoh settings are in this file (JSON5, Zenoh's own keys),
named by `zenoh.file` and `zenoh.client_file`. Relative paths in it are relative to the working
directory, as in Zenoh. The service manager may pass copies of secret files
(`edge.host.credentials`), named by the last part of their key, such as `listen_private_key`; the
copy of the service's own file is `zenoh.file.json5`. For settings that `edge` sets as well:

- `mode` comes from `zenoh.mode`: a file with another mode is refused.
- Endpoints add up: `zenoh.endpoint` is first, those of the file follow.
- Connection timeouts are `edge`'s, because it handles signals between attempts.
- Shared memory is off if `zenoh.shared_memory` or the file says so.
- `edge`'s `DEFAULTS` apply to the keys for which the file keeps Zenoh's own default.

In `edge.bus`, `native` is a configuration of Zenoh (`zenoh.Config`), and `settings` is the section
`zenoh` of our configuration.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from typing import Any

import zenoh

from edge.config.loop import KEY_IN_ENDPOINT
from edge.errors import ConfigError
from edge.host.credentials import credential_path, is_open_to_others
from edge.host.ports import MOST_PORT, is_loopback
from edge.text import one_line

BLOCKED_S = 1.0
"""Time in seconds that a message may wait for a peer, before Zenoh disconnects the peer."""
TLS = "transport/link/tls"

# A client that connects and stays silent holds one of Zenoh's places for pending connections: 100
# for 10 s each, so 120 idle clients lock out everybody. Here are more places, freed sooner. Pending
# connections and sessions together stay below 1024, the usual limit of file descriptors.
PENDING = 512
"""Largest number of pending connections."""
HANDSHAKE_MS = 2000
"""Longest time of a connection until its session is open, in ms."""
SESSIONS = 128
"""Largest number of sessions."""

DEFAULTS: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    # A peer that gossips sends addresses, and each receiver connects to them.
    "scouting/gossip/enabled": False,
    "transport/unicast/accept_pending": PENDING,
    "transport/unicast/accept_timeout": HANDSHAKE_MS,
    "transport/unicast/max_sessions": SESSIONS,
}
"""Values for keys that the file does not change."""

_HOST_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")  # their addresses are HOST:PORT
_OTHER_PROTOCOLS = ("serial", "unixsock-stream", "unixpipe", "vsock")
# HOST:PORT, such as `robot.local:7447` or `[::1]:7447`.
_HOST_PORT = re.compile(r"(\[[^][\s/]+\]|[^][\s/:]+):(?P<port>[0-9]{1,5})")
_WAIT_BEFORE_CLOSE = "transport/link/tx/queue/congestion_control/block/wait_before_close"  # µs
_MAX_MESSAGE_BYTES = "transport/link/rx/max_message_size"
_SHARED_MEMORY = "transport/shared_memory/enabled"
_TLS_HANDSHAKE = "tls_handshake_timeout_ms"
_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}
_ATTEMPT_MS = 500  # length of one attempt to connect
_USERS = "transport/auth/usrpwd/dictionary_file"
# Keys that name secret files.
_SECRETS = (f"{TLS}/listen_private_key", f"{TLS}/connect_private_key", _USERS)
# If one of these keys is set, the configuration file itself is secret.
_INLINE_SECRETS = (
    "transport/auth/usrpwd/password",
    f"{TLS}/listen_private_key_base64",
    f"{TLS}/connect_private_key_base64",
)
_TLS_PROTOCOLS = ("tls", "quic")
# Only processes of this computer can connect with these.
_LOCAL_PROTOCOLS = ("unixsock-stream", "unixpipe", "serial", "vsock")


def read_zenoh_file(key: str, name: str | None) -> zenoh.Config:
    """Return the configuration in a file; without a file, Zenoh's defaults.

    Args:
        key: the configuration key that names the file, for errors.
        name: path of the file, or None.

    Raises:
        ConfigError: the file cannot be read, or Zenoh rejects it. The message is one line and
            quotes no value, since a value may be a password.
    """
    if name is None:
        return zenoh.Config()
    path = credential_path(_copy_name(key, name), name)
    if not path.is_file():
        raise ConfigError(f"{key}: {name}: no such file")
    try:
        native = zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        raise ConfigError(f"{key}: {name}: {_fault_without_values(str(error))}") from None
    for secret in _SECRETS:
        if (file := get(native, secret)) is not None:
            native.insert_json5(secret, json.dumps(str(credential_path(_last_word(secret), file))))
    return native


def _copy_name(key: str, name: str) -> str:
    """Return the name of the service manager's copy; Zenoh knows the format by the suffix."""
    return key + os.path.splitext(name)[1]


def _last_word(key: str) -> str:
    return key.rpartition("/")[2]


def apply_settings(
    native: zenoh.Config,
    mode: str,
    endpoint: str,
    listens: bool,
    shared_memory: bool,
    keep_zenoh_timeout: bool,
    most_bytes: int | None,
) -> zenoh.Config:
    """Change a configuration in place as the module's docstring says, and return it.

    Args:
        native: Zenoh's configuration.
        mode: `peer`, `client` or `router`.
        endpoint: `zenoh.endpoint`.
        listens: True to listen at the endpoint, False to connect to it.
        shared_memory: `zenoh.shared_memory`.
        keep_zenoh_timeout: see `edge.bus.session.session_config`.
        most_bytes: longest fragmented message that is accepted; None keeps Zenoh's 1 GiB.

    Raises:
        ConfigError: the file has another mode, or a private key in an endpoint.
    """
    file_mode = get(native, "mode")
    if file_mode not in (None, mode):
        raise ConfigError(
            f"mode is {file_mode!r}, but edge sets {mode!r} here: remove mode from this file "
            "(zenoh.mode in edge's configuration chooses)"
        )
    listening = _endpoints_of_file(native, "listen/endpoints", mode)
    connecting = _endpoints_of_file(native, "connect/endpoints", mode)
    if any(KEY_IN_ENDPOINT in other for other in (*listening, *connecting)):
        raise ConfigError(
            f"an endpoint has a private key ({KEY_IN_ENDPOINT}): move the key to {TLS} of this file"
        )
    first = [_with_handshake_timeout(endpoint)] if listens else [endpoint]
    values = {
        "mode": mode,
        "listen/endpoints": _without_duplicates(first + listening) if listens else [],
        "connect/endpoints": connecting if listens else _without_duplicates(first + connecting),
        "connect/timeout_ms": _ATTEMPT_MS,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        _SHARED_MEMORY: shared_memory and get(native, _SHARED_MEMORY),
    }
    # Publishers that keep their last message for late subscribers (`edge.bus.ros2`) need stamps.
    defaults = DEFAULTS | {"timestamping/enabled": mode == "client"}
    if not keep_zenoh_timeout:
        defaults[_WAIT_BEFORE_CLOSE] = int(1e6 * BLOCKED_S)
    if most_bytes is not None:
        defaults[_MAX_MESSAGE_BYTES] = most_bytes
    zenoh_defaults = zenoh.Config()
    unchanged = (key for key in defaults if get(native, key) == get(zenoh_defaults, key))
    values |= {key: defaults[key] for key in unchanged}  # the file's own values stay
    for key, value in values.items():
        native.insert_json5(key, json.dumps(value))
    return native


def get(native: zenoh.Config, key: str) -> Any:
    """Return the value of a key of Zenoh's configuration."""
    return json.loads(native.get_json(key))


def open_addresses(native: zenoh.Config) -> list[str]:
    """Return the listening addresses that are open to everybody.

    An address is open if other computers can reach it, and if it requires no certificate and no
    password.
    """
    if get(native, _USERS) is not None:
        return []
    mutual = "true" if get(native, f"{TLS}/enable_mtls") else "false"

    def is_open(endpoint: str) -> bool:
        kind, host = protocol(endpoint), host_and_port(endpoint)[0]
        is_mutual = parameters(endpoint).get("enable_mtls", mutual) == "true"
        asks_for_certificate = kind in _TLS_PROTOCOLS and is_mutual
        return not (kind in _LOCAL_PROTOCOLS or is_loopback(host) or asks_for_certificate)

    endpoints = get(native, "listen/endpoints")
    return [endpoint.partition("#")[0] for endpoint in endpoints if is_open(endpoint)]


def host_and_port(endpoint: str) -> tuple[str, int]:
    """Split an endpoint such as `tls/[::1]:7447#…`; port 0 if there is none."""
    # PROTOCOL/ADDRESS?METADATA#PARAMETERS
    address = re.split(r"[?#]", endpoint.partition("/")[2], maxsplit=1)[0]
    host, _, port = address.rpartition(":")
    return host.strip("[]"), int(port) if port.isdecimal() else 0


def endpoint_fault(endpoint: str) -> str | None:
    """Return the fault in an endpoint's syntax, or None.

    Zenoh reports such faults only to a listener; a client would wait forever.
    """
    kind, slash, rest = endpoint.partition("/")
    address = re.split(r"[?#]", rest, maxsplit=1)[0]
    if not slash or not address:
        return "expected PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"
    if kind not in (*_HOST_PROTOCOLS, *_OTHER_PROTOCOLS):
        known = ", ".join((*_HOST_PROTOCOLS, *_OTHER_PROTOCOLS))
        return f"unknown protocol {one_line(kind, 40)!r} ({known})"
    match = _HOST_PORT.fullmatch(address)
    if kind in _HOST_PROTOCOLS and (match is None or int(match["port"]) > MOST_PORT):
        return f"expected HOST:PORT after {kind}/, the port from 0 to {MOST_PORT}"
    return None


def protocol(endpoint: str) -> str:
    """Return the protocol of an endpoint, such as `tls`."""
    return endpoint.partition("/")[0]


def parameters(endpoint: str) -> dict[str, str]:
    """Return the parameters of an endpoint, after `#`: `a=1;b=2`."""
    pairs = (pair.partition("=") for pair in endpoint.partition("#")[2].split(";") if pair)
    return {name: value for name, _, value in pairs}


def _endpoints_of_file(native: zenoh.Config, key: str, mode: str) -> list[str]:
    """Return the endpoints of a mode that the file names, without Zenoh's defaults."""
    value = get(native, key)
    if value == get(zenoh.Config(), key):
        return []
    value = value.get(mode, []) if isinstance(value, dict) else value
    return [value] if isinstance(value, str) else list(value)


def _without_duplicates(endpoints: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(endpoints))


def _with_handshake_timeout(endpoint: str) -> str:
    """Add a timeout for TLS handshakes to a listening endpoint that has none.

    Zenoh's configuration file has no key for it.
    """
    if protocol(endpoint) != "tls" or _TLS_HANDSHAKE in parameters(endpoint):
        return endpoint
    return f"{endpoint}{';' if '#' in endpoint else '#'}{_TLS_HANDSHAKE}={HANDSHAKE_MS}"


def unreadable_file(native: zenoh.Config, listens: bool) -> str | None:
    """Return an error for the first TLS or user file that cannot be read, or None.

    Only files of the role are checked (listener or client). Zenoh's own error names no file.
    """
    keys = [f"{TLS}/root_ca_certificate"]
    if listens:
        keys += [f"{TLS}/listen_certificate", f"{TLS}/listen_private_key", _USERS]
    else:
        keys += [f"{TLS}/connect_certificate", f"{TLS}/connect_private_key"]
    for key in keys:
        path = get(native, key)
        if path is not None and not os.access(path, os.R_OK):
            return f"{key}: {path}: no such file, or no permission to read it"
    return None


def certificates(native: zenoh.Config) -> list[str]:
    """Return the configured certificate files; these are not secret."""
    kinds = ("root_ca_certificate", "listen_certificate", "connect_certificate")
    paths = [get(native, f"{TLS}/{kind}") for kind in kinds]
    return [path for path in paths if path is not None]


def secrets(native: zenoh.Config, key: str, name: str | None) -> dict[str, str]:
    """Return the files with secrets: name of the service manager's copy → path.

    Args:
        native: Zenoh's configuration.
        key: the configuration key of Zenoh's file, which may hold a secret itself.
        name: path of Zenoh's file, or None.
    """
    files = {_last_word(secret): get(native, secret) for secret in _SECRETS}
    if name is not None and any(get(native, word) is not None for word in _INLINE_SECRETS):
        copy = _copy_name(key, name)
        files[copy] = str(credential_path(copy, name))
    return {name: path for name, path in files.items() if path is not None}


def exposed_secrets(native: zenoh.Config, key: str, name: str | None) -> list[str]:
    """Return the files of `secrets` that other users of this computer can read or write."""
    return [path for path in secrets(native, key, name).values() if is_open_to_others(path)]


def denies_prefix(native: zenoh.Config, prefix: str) -> bool:
    """Return True if the access rules deny every key below a prefix."""
    control = get(native, "access_control")
    if not control["enabled"] or control["default_permission"] == "allow":
        return False
    below_prefix = zenoh.KeyExpr(f"{prefix}/**")
    allowed = (rule for rule in control["rules"] or () if rule["permission"] == "allow")
    return not any(below_prefix.intersects(key) for rule in allowed for key in rule["key_exprs"])


# Parts of Zenoh's errors: `line: 3, column: 5` or `--> 3:5`; `msg: "invalid type: …"`; in it, a
# value of the file that must not be shown (`invalid type: string \"secret\"`); `= expected …`.
_LINE_COLUMN = re.compile(r"line: (\d+), column: (\d+)|--> (\d+):(\d+)")
_QUOTED_MESSAGE = re.compile(r'msg: "((?:[^"\\]|\\.)*)"', re.DOTALL)
_QUOTED_VALUE = re.compile(
    r'(invalid (?:type|value): [a-z -]+?|unknown variant) (?:`.*?`|\\".*\\")', re.DOTALL
)
_EXPECTED = re.compile(r"= (expected .*)")


def _fault_without_values(error: str) -> str:
    """Return Zenoh's error about a file with line and column, but without the file's values."""
    place = _LINE_COLUMN.search(error)
    if place is None:
        return one_line(error.split(" at /")[0])
    line, column = (number for number in place.groups() if number is not None)
    # A message in quotes: cut out the value. Else only what was expected is safe to show.
    if quoted := _QUOTED_MESSAGE.search(error):
        what = _QUOTED_VALUE.sub(r"\1", quoted[1]).partition('\\"')[0]
    else:
        expected = _EXPECTED.search(error)
        what = expected[1].split(" at /")[0] if expected else "not JSON5"
    return f"line {line}, column {column}: {one_line(what)}"
