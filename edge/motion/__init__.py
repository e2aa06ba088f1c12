"""The reference motion controller, a process of its own that drives to published goals.

It hears the bus and nothing else: the service does not know which controller drives.
"""
