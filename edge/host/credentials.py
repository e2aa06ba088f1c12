"""Files with secrets, and the copies of them that a service manager hands over.

`LoadCredential=NAME:FILE` (systemd.exec(5)) gives a service a copy of a file that root alone can
read, whoever its user is: one that is made up at each start, too. `edge run --install` writes
such lines.
"""

from __future__ import annotations

import hmac
import os
import stat
from pathlib import Path

from edge.errors import ConfigError
from edge.host.files import read_regular
from edge.host.resources import expand

COPIES = "CREDENTIALS_DIRECTORY"
SHORTEST = 16

_OTHERS = stat.S_IROTH | stat.S_IWOTH
_MAX_BYTES = 4096


def handed_over(name: str, path: str) -> Path:
    """The service manager's copy of a secret, where it has one of this name; else the file."""
    copy = Path(os.environ.get(COPIES, ""), name)
    return copy if COPIES in os.environ and copy.is_file() else expand(path)


def open_to_others(path: str | Path) -> bool:
    """Whether other users of this machine can read or write the file; what is not there, nobody."""
    try:
        return bool(os.stat(path).st_mode & _OTHERS)
    except OSError:
        return False


class Token:
    """What whoever asks must know, compared in constant time; it shows itself nowhere."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def is_borne_by(self, authorization: str) -> bool:
        """Whether a request's header `Authorization` has it (RFC 6750, section 2.1)."""
        scheme, _, said = authorization.partition(" ")
        return scheme.lower() == "bearer" and hmac.compare_digest(
            said.strip().encode("utf-8", "replace"), self._secret
        )

    def header(self) -> dict[str, str]:
        """What a request of one's own says."""
        return {"Authorization": f"Bearer {self._secret.decode()}"}


def read_token(key: str, name: str) -> Token:
    """The one line of a file.

    Args:
        key: that names the file; its copy has the same name (`handed_over`).

    Raises:
        ConfigError: it cannot be read, or is no token; one line, which does not quote it.
    """
    try:
        secret = read_regular(handed_over(key, name), _MAX_BYTES).strip()
    except OSError as error:
        raise ConfigError(f"{key}: {name}: {error.strerror}") from None
    if len(secret) < SHORTEST or not all(33 <= byte < 127 for byte in secret):
        raise ConfigError(
            f"{key}: {name}: expected one word of {SHORTEST} letters or more, "
            "as `openssl rand -hex 32` makes it"
        )
    return Token(secret)
