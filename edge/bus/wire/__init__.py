"""Wire format: ROS 2 messages as CDR (see `edge.bus.wire.messages`)."""

from edge.bus.wire.cdr import DecodeError

__all__ = ["DecodeError"]
