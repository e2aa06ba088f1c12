"""A Zenoh session whose sender may be faster than any reader."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace

import zenoh


class Flooded:
    """Stands in for a session, its subscribers and its rings."""

    def __init__(self, key: str, payloads: Iterable[bytes]) -> None:
        self._key, self._payloads = key, iter(payloads)

    def declare_subscriber(self, key: str, ring: object) -> Flooded:
        return self if key == self._key else Flooded(key, ())

    declare_queryable = declare_subscriber

    def declare_publisher(self, *_: object, **__: object) -> Flooded:
        return self

    def undeclare(self) -> None: ...

    def try_recv(self) -> SimpleNamespace | None:
        payload = next(self._payloads, None)
        return None if payload is None else SimpleNamespace(payload=zenoh.ZBytes(payload))
