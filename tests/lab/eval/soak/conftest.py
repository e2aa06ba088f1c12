"""`edge` commands as processes."""

from edge_processes import edge

__all__ = ["edge"]
