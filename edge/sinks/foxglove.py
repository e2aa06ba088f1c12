"""Live view for Foxglove: the channels of a recording over a WebSocket server of `foxglove-sdk`.

Only subscribed channels are copied and encoded, on the sink's thread. There is no authentication:
everyone who reaches the port sees what the robot sees.
"""

from __future__ import annotations

import logging
import threading
from typing import Any

from edge.config import Config
from edge.errors import ConfigError, UnavailableError
from edge.host.ports import MOST_PORT, is_loopback
from edge.host.worker import Worker
from edge.loop.result import TickResult
from edge.recording import channels
from edge.recording.channels import Channel
from edge.sinks.encoder import ResultEncoder, ResultSnapshot
from edge.text import one_line

log = logging.getLogger("edge.sinks.foxglove")

_CLOSE_S = 1.0  # longest time to send what is pending at the end
_MOST_PENDING_BYTES = 64_000_000  # of arrays that wait; beyond, ticks come without arrays
_BACKLOG = 256  # messages queued for a client; the oldest are dropped


class FoxgloveSink:
    """Serves the channels of `edge.recording.channels`; no method blocks.

    Args:
        host: address to listen on; other computers can reach any but a loopback address.
        port: 0 chooses a free one.
        rgb_hz: rate of images, sent as JPEG.

    Raises:
        ConfigError: `foxglove-sdk` is not installed.
        UnavailableError: cannot listen on the port.
    """

    def __init__(
        self, config: Config, host: str = "127.0.0.1", port: int = 8765, rgb_hz: float = 10.0
    ) -> None:
        foxglove = _import_sdk()
        self._context = context = foxglove.Context()  # channels do not keep it alive
        self._channels = {
            channel: foxglove.Channel(
                channel.topic,
                schema=foxglove.Schema(
                    name=channel.schema, encoding=channel.schema_encoding,
                    data=channel.schema_text.encode(),
                ),
                message_encoding=channel.encoding,
                context=context,
            )
            for channel in channels.VISUAL
        }  # fmt: skip
        try:
            self._server = foxglove.start_server(
                name="edge", host=host, port=port, context=context, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # a private class of the SDK
            raise UnavailableError(
                f"sinks: foxglove: cannot listen on {one_line(host)} port {port}: "
                f"{one_line(error)}; set another port in the options of this sink"
            ) from None
        self.port = self._server.port
        if not is_loopback(host):
            log.warning("sinks: foxglove: everyone who can connect to %s port %d sees what the "
                        "robot sees", host, self.port)  # fmt: skip
        self._encoder = ResultEncoder(config, rgb_hz, self._is_subscribed)
        self._pending_bytes = 0  # of the arrays that wait
        self._lock = threading.Lock()  # for pending bytes
        self._worker: Worker[tuple[ResultSnapshot, int], None] = Worker(
            "foxglove-sink", self._send, drop=lambda item: self._release(item[1])
        )

    @staticmethod
    def check_options(host: str = "127.0.0.1", port: int = 8765, rgb_hz: float = 10.0) -> None:
        """Raise an error for an invalid port or a missing SDK; see `edge.config.components`."""
        if type(port) is not int or not 0 <= port <= MOST_PORT:
            raise ConfigError(
                f"sinks: foxglove: port: expected a number from 0 to {MOST_PORT}, got {port!r:.40}"
            )
        _import_sdk()

    def tick(self, result: TickResult) -> None:
        """Copy the subscribed data; see `edge.loop.result.Sink`."""
        snapshot = self._encoder.capture(result, arrays=self._pending_bytes < _MOST_PENDING_BYTES)
        if snapshot.messages:
            size = snapshot.bytes
            with self._lock:
                self._pending_bytes += size
            self._worker.enqueue((snapshot, size))

    def status(self) -> dict[str, Any]:
        """Return port and worker statistics; see `edge.loop.result.Sink`."""
        return {"port": self.port, **self._worker.stats.status()}

    def close(self) -> None:
        """Disconnect all clients."""
        self._worker.close(_CLOSE_S)
        self._server.stop()

    def _is_subscribed(self, channel: Channel) -> bool:
        return bool(self._channels[channel].has_sinks())  # the SDK's sinks are its clients

    def _release(self, size: int) -> None:
        with self._lock:
            self._pending_bytes -= size

    def _send(self, item: tuple[ResultSnapshot, int]) -> None:
        """Encode and send a snapshot; `item` has the size of its arrays, too."""
        snapshot, size = item
        try:
            for message in self._encoder.encode(snapshot):
                payload = b"".join(message.payload)
                self._channels[message.channel].log(payload, log_time=max(0, snapshot.now_ns))
        finally:
            self._release(size)
        self._encoder.release(snapshot)


def _import_sdk() -> Any:
    try:
        import foxglove
    except ImportError:
        raise ConfigError(
            "sinks: foxglove: foxglove-sdk is not installed: pip install 'edge-vln[foxglove]'"
        ) from None
    return foxglove
