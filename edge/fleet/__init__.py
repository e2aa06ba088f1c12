"""Fleet: several robots over one router. Lists the robots, assigns missions and follows them.

This package uses only the requests that a single robot serves (`edge.bus.client`). It does not
control the way in which a robot does its mission.
"""
