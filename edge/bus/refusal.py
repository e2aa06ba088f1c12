"""Why nobody took us in: Zenoh only says that it could not connect.

After an attempt that failed, the endpoint is tried with Python's own sockets and TLS, with the
certificates that Zenoh was given.
"""

from __future__ import annotations

import socket
import ssl
import threading

import zenoh

from edge.bus.zenoh_file import TLS, get, host_and_port, parameters, protocol, unreadable
from edge.host.interruptible import start_unjoined
from edge.text import one_line

PROBE_S = 0.5
_NAME_S = 1.0  # to find the address of a name; the resolver's own patience is longer

_CLIENTS = "root_ca_certificate", "connect_certificate", "connect_private_key"
_IN_PLACE = "_base64"

# What a TLS peer's alert means to us: RFC 8446, section 6.2. OpenSSL puts the protocol before it.
_ALERTS = {
    "CERTIFICATE_REQUIRED": "it wants a certificate, and {file} names none "
    "(transport/link/tls: enable_mtls, connect_certificate, connect_private_key)",
    "UNKNOWN_CA": "it does not trust who signed our certificate",
    "DECRYPT_ERROR": "it does not trust who signed our certificate",
    "BAD_CERTIFICATE": "it does not take our certificate",
    "CERTIFICATE_EXPIRED": "our certificate is out of date, or the clock there is wrong ({file})",
    "CERTIFICATE_REVOKED": "our certificate was revoked",
    "CERTIFICATE_UNKNOWN": "it does not take our certificate",
    "ACCESS_DENIED": "it does not take our certificate",
}
_OUT_OF_DATE = (9, 10)  # X509_V_ERR_CERT_NOT_YET_VALID, …_HAS_EXPIRED
_NO_TLS = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "UNEXPECTED_EOF_WHILE_READING")
_NOT_TAKEN_IN = (
    "somebody is there and takes no session: either it asks for a user and a password, or for "
    "others than {file} gives (transport/auth/usrpwd), or it is full, or it speaks TLS or no Zenoh"
)
_NOT_TAKEN_IN_BY_TLS = (
    "somebody is there and takes no session: of the certificates in {file}, one is not trusted "
    "(what they are is not looked at here, since they are written in place), or a user is asked for"
)
_NOT_TAKEN_IN_TLS = (
    "TLS is agreed on, and no session is taken: either it asks for a user and a password, or for "
    "others than {file} gives (transport/auth/usrpwd), or it is full"
)


class UnknownHostError(Exception):
    """No address is known for the host of an endpoint; its message says for which, and why."""


def why_refused(endpoint: str, found: zenoh.Config, file: str) -> str | None:
    """Why there is no session with who is at an endpoint; None: nobody is there.

    Waits for `_NAME_S` and twice `PROBE_S` at most.

    Args:
        endpoint: such as `tls/robot.local:7447`.
        found: what the session was to be opened with.
        file: where its user would look, for the line: a path, or the key that would name one.

    Raises:
        UnknownHostError: no address is known for the endpoint's host.
    """
    if (lacks := unreadable(found, listens=False)) is not None:
        return lacks
    if protocol(endpoint) not in ("tcp", "tls") or not host_and_port(endpoint)[1]:
        return None
    said: list[str | UnknownHostError | None] = []
    # A name that nobody knows may be looked for during half a minute.
    known = threading.Event()
    probe = start_unjoined("probe", lambda: said.append(_probe(endpoint, found, file, known)))
    probe.join(_NAME_S + 2 * PROBE_S)
    answer = said[0] if said else None
    if not said and not known.is_set():
        host = one_line(host_and_port(endpoint)[0])
        answer = UnknownHostError(f"no address is known for {host!r}: the name service is silent")
    if isinstance(answer, UnknownHostError):
        raise answer
    return answer


def _probe(
    endpoint: str, found: zenoh.Config, file: str, known: threading.Event
) -> str | UnknownHostError | None:
    """Try the endpoint; set `known` once its host has an address."""
    host, port = host_and_port(endpoint)
    try:
        socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        known.set()
        with socket.create_connection((host, port), PROBE_S) as plain:
            if protocol(endpoint) == "tcp":
                return _NOT_TAKEN_IN.format(file=file)
            return _tls_refusal(plain, host, endpoint, found, file)
    except (socket.gaierror, UnicodeError) as error:  # UnicodeError: a label no name may have
        why = getattr(error, "strerror", None) or "no such name can be"
        return UnknownHostError(f"no address is known for {one_line(host)!r} ({one_line(why)})")
    except OSError:
        return None


def _tls_refusal(
    plain: socket.socket, host: str, endpoint: str, found: zenoh.Config, file: str
) -> str:
    if _IN_PLACE in endpoint or any(get(found, f"{TLS}/{key}{_IN_PLACE}") for key in _CLIENTS):
        return _NOT_TAKEN_IN_BY_TLS.format(file=file)
    try:
        context = _context(endpoint, found)
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        return f"its certificates cannot be used: {one_line(error)}"
    try:
        with context.wrap_socket(plain, server_hostname=host) as secure:
            # Under TLS 1.3 our certificate is judged when we are through with the handshake.
            secure.recv(1)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code in _OUT_OF_DATE:
            said = one_line(error.verify_message)
            return f"its certificate is out of date, or the clock here is wrong ({said})"
        return (
            f"its certificate is not trusted ({one_line(error.verify_message)}); "
            f"see transport/link/tls/root_ca_certificate in {file}"
        )
    except ssl.SSLError as error:
        reason = error.reason or ""
        for alert, says in _ALERTS.items():
            if reason.endswith(alert):
                return says.format(file=file)
        if reason in _NO_TLS:
            return "it does not speak TLS: give its endpoint as tcp/…"
        return f"TLS is not agreed on ({one_line(reason or error)})"
    except OSError:  # it says nothing, as a Zenoh that waits for us does, or hangs up
        pass
    return _NOT_TAKEN_IN_TLS.format(file=file)


def _context(endpoint: str, found: zenoh.Config) -> ssl.SSLContext:
    """As Zenoh would have it; what the endpoint itself says counts more than the file."""
    said = parameters(endpoint)

    def setting(key: str, parameter: str) -> object:
        return said.get(parameter, get(found, f"{TLS}/{key}"))

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = setting("verify_name_on_connect", "verify_name_on_connect") not in (
        False, "false",
    )  # fmt: skip
    if isinstance(roots := setting("root_ca_certificate", "root_ca_certificate_file"), str):
        context.load_verify_locations(cafile=roots)
    else:
        context.load_default_certs()
    mutual = setting("enable_mtls", "enable_mtls") in (True, "true")
    certificate = setting("connect_certificate", "connect_certificate_file")
    key = setting("connect_private_key", "connect_private_key_file")
    if mutual and isinstance(certificate, str) and isinstance(key, str):
        context.load_cert_chain(certificate, key)
    return context
