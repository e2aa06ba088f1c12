"""Files with secrets, and the copies of them that systemd gives to a service.

`LoadCredential=NAME:FILE` (systemd.exec(5)) gives a service of any user, also a dynamic one, a copy
of a file that only root can read. `edge run --install` writes such lines.
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
"""Environment variable with the folder of systemd's copies."""
SHORTEST = 16
"""Characters of the shortest token."""

_OTHERS = stat.S_IROTH | stat.S_IWOTH
_MAX_BYTES = 4096  # of a file with a token


def credential_path(name: str, path: str) -> Path:
    """Return systemd's copy of a secret if there is one of this name, else the file itself."""
    copy = Path(os.environ.get(COPIES, ""), name)
    return copy if COPIES in os.environ and copy.is_file() else expand(path)


def is_open_to_others(path: str | Path) -> bool:
    """Return True if other users can read or write the file; False if it does not exist."""
    try:
        return bool(os.stat(path).st_mode & _OTHERS)
    except OSError:
        return False


class BearerToken:
    """A bearer token, compared in constant time and never shown."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def matches(self, authorization: str) -> bool:
        """Return True if a header `Authorization` has this token (RFC 6750, section 2.1)."""
        scheme, _, given = authorization.partition(" ")
        return scheme.lower() == "bearer" and hmac.compare_digest(
            given.strip().encode("utf-8", "replace"), self._secret
        )

    def header(self) -> dict[str, str]:
        """Return the header that sends this token."""
        return {"Authorization": f"Bearer {self._secret.decode()}"}


def read_token(key: str, name: str) -> BearerToken:
    """Read a token from a file, or from systemd's copy of it.

    Args:
        key: key of the configuration that names the file; also the name of the copy.
        name: path of the file.

    Raises:
        ConfigError: the file cannot be read or has no valid token. The message does not quote it.
    """
    try:
        secret = read_regular(credential_path(key, name), _MAX_BYTES).strip()
    except OSError as error:
        raise ConfigError(f"{key}: {name}: cannot be read: {error.strerror}") from None
    if len(secret) < SHORTEST or not all(33 <= byte < 127 for byte in secret):
        raise ConfigError(
            f"{key}: {name}: expected one word of {SHORTEST} characters or more; "
            "make one with `openssl rand -hex 32`"
        )
    return BearerToken(secret)
