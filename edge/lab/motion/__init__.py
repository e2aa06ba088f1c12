"""The reference motion controller, a process of its own that drives to published goals.

It knows the service by its topics alone, so that any controller of a robot may take its place.
"""
