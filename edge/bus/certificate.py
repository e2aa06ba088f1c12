"""The service's certificate, as its clients will see it.

Zenoh listens with one that is out of date, or of another authority than its clients', and says
nothing: only they are refused. So a TLS handshake is made here with ourselves, in memory.
"""

from __future__ import annotations

import ssl
import time

import zenoh

from edge.bus.zenoh_file import TLS, get
from edge.text import one_line

SOON_S = 30 * 86400.0

_OUT_OF_DATE = (9, 10)
_MOST_PASSES = 8  # TLS 1.3 takes two


def out_of_date(error: ssl.SSLCertVerificationError) -> bool:
    """Whether that is what is wrong with it: X509_V_ERR_CERT_NOT_YET_VALID, …_HAS_EXPIRED."""
    return error.verify_code in _OUT_OF_DATE


def judge(found: zenoh.Config, now_s: float | None = None) -> str | None:
    """What is wrong, or soon will be, with the certificate that is listened with; one line.

    None: nothing, or none is named in a file together with its authority.
    """
    names = ("listen_certificate", "listen_private_key", "root_ca_certificate")
    certificate, key, roots = (get(found, f"{TLS}/{name}") for name in names)
    if certificate is None or key is None or roots is None:
        return None
    try:
        rest_s = runs_out(certificate, key, roots) - (time.time() if now_s is None else now_s)
    except ssl.SSLCertVerificationError as error:
        why = one_line(error.verify_message)
        if out_of_date(error):
            return f"{certificate}: out of date, or the clock is wrong ({why}): nobody takes it"
        return f"{certificate}: whoever trusts {roots} does not take it ({why})"
    except OSError as error:  # ssl.SSLError is one
        return f"{certificate}: cannot be used with its key and authority ({one_line(error)})"
    if rest_s < SOON_S:
        return f"{certificate}: runs out in {rest_s / 86400:.0f} days: make a new one"
    return None


def runs_out(certificate: str, key: str, roots: str) -> float:
    """When a certificate runs out, in seconds since 1970.

    Raises:
        ssl.SSLCertVerificationError: who trusts `roots` does not take it.
        OSError: a file cannot be read, or is none.
    """
    ours = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    ours.load_cert_chain(certificate, key)
    theirs = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    theirs.check_hostname = False
    theirs.load_verify_locations(roots)
    said, heard = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = theirs.wrap_bio(heard, said)
    sides = client, ours.wrap_bio(said, heard, server_side=True)
    for _ in range(_MOST_PASSES):
        are_through = [_is_through(side) for side in sides]
        if all(are_through):
            break
    return float(ssl.cert_time_to_seconds(client.getpeercert()["notAfter"]))


def _is_through(side: ssl.SSLObject) -> bool:
    try:
        side.do_handshake()
    except ssl.SSLWantReadError:
        return False
    return True
