"""Files that say what they are, of which version, and by a checksum that they are whole."""

from __future__ import annotations

import hashlib
import re
from typing import NamedTuple


class Sealed(NamedTuple):
    """A format: one line `{"format", "version", "sha256", …}` and a body that the checksum is over.

    Attributes:
        name: of the format; `what`: for people.
        rest: a pattern of what follows the checksum, the group `body` in it.
        max_bytes: of a file.
    """

    name: str
    what: str
    version: int
    rest: bytes
    max_bytes: int

    @property
    def begins(self) -> bytes:
        """The first bytes of every file of this format, of whichever version."""
        return b'{"format":"%s",' % self.name.encode()

    def seal(self, before: str, body: bytes, after: bytes = b"") -> bytes:
        """The file's content.

        Args:
            before, after: what stands around the body, as `rest` says.

        Raises:
            ValueError: with one line: it is too long.
        """
        head = f'"version":{self.version},"sha256":"{_sha256(body)}",{before}'
        content = b"".join((self.begins, head.encode(), body, after))
        if len(content) > self.max_bytes:
            raise ValueError(f"{len(content)} bytes, at most {self.max_bytes} are kept")
        return content

    def open(self, content: bytes) -> tuple[re.Match[bytes], memoryview]:
        """The groups of `rest` and the body of a file that is whole.

        Raises:
            ValueError: with one line that says what is wrong.
        """
        if len(content) > self.max_bytes:
            raise ValueError(f"more than {self.max_bytes} bytes")
        head = re.escape(self.begins) + rb'"version":([0-9]{1,9}),"sha256":"([0-9a-f]{64})",'
        whole = re.fullmatch(head + self.rest, content, re.DOTALL)
        if whole is None:
            raise ValueError(f"not a whole {self.what}")
        if int(whole[1]) != self.version:
            raise ValueError(f"version {int(whole[1])}, this program reads {self.version}")
        body = memoryview(content)[slice(*whole.span("body"))]
        if _sha256(body).encode() != whole[2]:
            raise ValueError("damaged: its checksum does not match")
        return whole, body


def _sha256(body: bytes | memoryview) -> str:
    return hashlib.sha256(body).hexdigest()
