"""The reference motion controller, a process of its own that drives to published goals."""
