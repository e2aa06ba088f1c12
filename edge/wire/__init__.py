"""The binary format on the wire: ROS 2 messages as CDR (see `edge.wire.messages`)."""

from edge.wire.cdr import DecodeError

__all__ = ["DecodeError"]
