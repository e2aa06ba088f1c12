"""A real HTTP server, in a thread, that speaks KServe's protocol, falsely on command."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from http_server import Quiet, running, send

from edge.perception.runtime.kserve_messages import BINARY, HEADER_LENGTH

Run = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]
Behaviour = Callable[["Handler"], None]


@dataclass
class KServe:
    """KServe v2 server with a detector.

    Attributes:
        run: the model.
        binary: True if tensors may be sent as bytes.
        behave: replacement of the inference; a test may set it.
        metadata: of the model.
        asked: requested paths, in order.
        connections: number of connections.
        stopping: set at the end, so that an endless behaviour returns.
    """

    run: Run
    binary: bool = True
    behave: Behaviour | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    url: str = ""
    asked: list[str] = field(default_factory=list)
    connections: int = 0
    stopping: threading.Event = field(default_factory=threading.Event)


class Handler(Quiet):
    """HTTP handler that a behaviour gets; `kserve` is the server."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    kserve: KServe

    def setup(self) -> None:
        super().setup()
        self.kserve.connections += 1

    def do_GET(self) -> None:
        self.kserve.asked.append(self.path)
        extensions = [BINARY] if self.kserve.binary else []
        told = {"name": "test", "version": "1", "extensions": extensions}
        self.send_json(told if self.path == "/v2" else {"name": "m", **self.kserve.metadata})

    def do_POST(self) -> None:
        self.kserve.asked.append(self.path)
        self.body = self.rfile.read(int(self.headers["Content-Length"]))
        with contextlib.suppress(ConnectionError):
            (self.kserve.behave or Handler.tell_the_truth)(self)

    def tell_the_truth(self) -> None:
        outputs = self.kserve.run(self.tensors())
        (self.send_tensors if self.kserve.binary else self.send_json_tensors)(outputs)

    def send_nothing(self) -> None:
        """Refuse every inference."""
        self.send(b"out of memory", 503)

    def tensors(self) -> dict[str, np.ndarray]:
        length = int(self.headers.get(HEADER_LENGTH, len(self.body)))
        told, at, found = json.loads(self.body[:length]), length, {}
        for entry in told["inputs"]:
            dtype = {"FP32": np.float32, "INT64": np.int64}[entry["datatype"]]
            if "data" in entry:
                array = np.array(entry["data"], dtype)
            else:
                size = entry["parameters"]["binary_data_size"]
                array, at = np.frombuffer(self.body[at : at + size], dtype), at + size
            found[entry["name"]] = array.reshape(entry["shape"])
        assert at == len(self.body)
        return found

    def send_tensors(self, outputs: dict[str, np.ndarray], **change: Any) -> None:
        """As bytes; `change` is put into the first output's entry."""
        entries = [
            {"name": name, "datatype": "FP32", "shape": list(array.shape),
             "parameters": {"binary_data_size": array.nbytes}}
            for name, array in outputs.items()
        ]  # fmt: skip
        entries[0] |= change
        head = json.dumps({"outputs": entries}).encode()
        blocks = [array.astype("<f4").tobytes() for array in outputs.values()]
        self.send(b"".join((head, *blocks)), **{HEADER_LENGTH: str(len(head))})

    def send_json_tensors(self, outputs: dict[str, np.ndarray]) -> None:
        entries = [
            {"name": name, "datatype": "FP32", "shape": list(array.shape),
             "data": array.ravel().tolist()}
            for name, array in outputs.items()
        ]  # fmt: skip
        self.send_json({"outputs": entries})

    def send_json(self, told: Any, status: int = 200) -> None:
        self.send(json.dumps(told).encode(), status)

    def send(self, body: bytes, status: int = 200, **headers: str) -> None:
        send(self, body, status, **headers)


@contextlib.contextmanager
def serving(kserve: KServe, port: int = 0) -> Iterator[KServe]:
    """Run the server on a local port."""

    class Bound(Handler):
        pass

    Bound.kserve = kserve
    kserve.stopping.clear()
    with running(Bound, kserve.stopping, port) as kserve.url:
        yield kserve
