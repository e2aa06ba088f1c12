"""Reference motion controller: a separate process that drives to published goals.

It uses only the service's topics, so a robot's own controller can replace it.
"""
