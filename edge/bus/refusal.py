"""Diagnosis of a refused connection: Zenoh only reports that it could not connect.

After a failed attempt, the endpoint is probed with Python's own sockets and TLS, with the
certificates that Zenoh was given.
"""

from __future__ import annotations

import socket
import ssl
import threading

import zenoh

from edge.bus.zenoh_file import TLS, get, host_and_port, parameters, protocol, unreadable_file
from edge.host.interruptible import start_detached_thread
from edge.text import one_line

PROBE_S = 0.5
"""Longest wait in seconds for the TCP connection."""
_NAME_S = 1.0  # to resolve a host name; the resolver's own timeout is longer

_CLIENT_KEYS = "root_ca_certificate", "connect_certificate", "connect_private_key"
_INLINE = "_base64"  # suffix of keys whose value is the certificate itself

# TLS alerts of the peer (RFC 8446, section 6.2) and our text for each. OpenSSL puts the protocol
# before the name.
_ALERTS = {
    "CERTIFICATE_REQUIRED": "the server requires a client certificate, and {file} names none "
    "(transport/link/tls: enable_mtls, connect_certificate, connect_private_key)",
    "UNKNOWN_CA": "the server does not trust the issuer of our certificate",
    "DECRYPT_ERROR": "the server does not trust the issuer of our certificate",
    "BAD_CERTIFICATE": "the server rejects our certificate",
    "CERTIFICATE_EXPIRED": "our certificate is out of date, or the clock of the server is wrong "
    "({file})",
    "CERTIFICATE_REVOKED": "our certificate was revoked",
    "CERTIFICATE_UNKNOWN": "the server rejects our certificate",
    "ACCESS_DENIED": "the server rejects our certificate",
}
_OUT_OF_DATE = (9, 10)  # X509_V_ERR_CERT_NOT_YET_VALID, …_HAS_EXPIRED
# OpenSSL's reasons if the other side answers the handshake with something that is not TLS.
_NO_TLS_REASONS = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "UNEXPECTED_EOF_WHILE_READING")
_REFUSED_TCP = (
    "a server is there but refuses the session: it asks for a user and a password, or {file} has "
    "wrong ones (transport/auth/usrpwd), or it is full, or it speaks TLS, or it is no Zenoh"
)
_REFUSED_UNCHECKED_TLS = (
    "a server is there but refuses the session: a certificate in {file} is not trusted (inline "
    "certificates are not checked here), or it asks for a user and a password"
)
_REFUSED_AFTER_TLS = (
    "TLS works, but the server refuses the session: it asks for a user and a password, or {file} "
    "has wrong ones (transport/auth/usrpwd), or it is full"
)


class UnknownHostError(Exception):
    """The host name of an endpoint cannot be resolved; the message has the name and the reason."""


def diagnose_refusal(endpoint: str, native: zenoh.Config, file: str) -> str | None:
    """Return why the server at an endpoint refuses a session; None if no server is there.

    Waits for at most `_NAME_S` + 2 `PROBE_S`.

    Args:
        endpoint: such as `tls/robot.local:7447`.
        native: Zenoh's configuration of the failed session.
        file: the file or configuration key that the user should check, for the message.

    Raises:
        UnknownHostError: the endpoint's host name cannot be resolved.
    """
    if (unreadable := unreadable_file(native, listens=False)) is not None:
        return unreadable
    if protocol(endpoint) not in ("tcp", "tls") or not host_and_port(endpoint)[1]:
        return None
    answers: list[str | UnknownHostError | None] = []
    # The resolver may search for an unknown name for half a minute.
    resolved = threading.Event()
    probe = start_detached_thread(
        "probe", lambda: answers.append(_probe(endpoint, native, file, resolved))
    )
    probe.join(_NAME_S + 2 * PROBE_S)
    answer = answers[0] if answers else None
    if not answers and not resolved.is_set():
        host = one_line(host_and_port(endpoint)[0])
        answer = UnknownHostError(f"no address is known for {host!r}: the name server is silent")
    if isinstance(answer, UnknownHostError):
        raise answer
    return answer


def _probe(
    endpoint: str, native: zenoh.Config, file: str, resolved: threading.Event
) -> str | UnknownHostError | None:
    """Try the endpoint; set `resolved` once its host has an address.

    Returns:
        As `diagnose_refusal`, but UnknownHostError is returned, since this runs on a thread.
    """
    host, port = host_and_port(endpoint)
    try:
        socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        resolved.set()
        with socket.create_connection((host, port), PROBE_S) as plain:
            if protocol(endpoint) == "tcp":
                return _REFUSED_TCP.format(file=file)
            return _tls_refusal(plain, host, endpoint, native, file)
    except (socket.gaierror, UnicodeError) as error:  # UnicodeError: not a valid host name
        why = getattr(error, "strerror", None) or "not a valid host name"
        return UnknownHostError(f"no address is known for {one_line(host)!r} ({one_line(why)})")
    except OSError:  # nothing listens there
        return None


def _tls_refusal(
    plain: socket.socket, host: str, endpoint: str, native: zenoh.Config, file: str
) -> str:
    """Try a TLS handshake over an open TCP connection; return why the server refuses."""
    if _INLINE in endpoint or any(get(native, f"{TLS}/{key}{_INLINE}") for key in _CLIENT_KEYS):
        return _REFUSED_UNCHECKED_TLS.format(file=file)
    try:
        context = _tls_context(endpoint, native)
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        return f"the certificates of {file} cannot be used: {one_line(error)}"
    try:
        with context.wrap_socket(plain, server_hostname=host) as secure:
            # With TLS 1.3 the server checks our certificate after our side of the handshake.
            secure.recv(1)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code in _OUT_OF_DATE:
            reason = one_line(error.verify_message)
            return f"the server's certificate is out of date, or the clock here is wrong ({reason})"
        return (
            f"the server's certificate is not trusted ({one_line(error.verify_message)}); "
            f"see transport/link/tls/root_ca_certificate in {file}"
        )
    except ssl.SSLError as error:
        reason = error.reason or ""
        for alert, text in _ALERTS.items():
            if reason.endswith(alert):
                return text.format(file=file)
        if reason in _NO_TLS_REASONS:
            return "the server does not speak TLS: give its endpoint as tcp/…"
        return f"client and server agree on no kind of TLS ({one_line(reason or error)})"
    except OSError:  # no answer yet, as from a Zenoh that waits for us, or connection closed
        pass
    return _REFUSED_AFTER_TLS.format(file=file)


def _tls_context(endpoint: str, native: zenoh.Config) -> ssl.SSLContext:
    """Return Zenoh's TLS context. The endpoint's own parameters override the file."""
    overrides = parameters(endpoint)

    def setting(key: str, parameter: str) -> object:
        return overrides.get(parameter, get(native, f"{TLS}/{key}"))

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
