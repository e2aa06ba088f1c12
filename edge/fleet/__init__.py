"""Fleet: several robots over one router. It lists robots, assigns missions and follows them.

It uses only the requests that a single robot serves (`edge.bus.client`). It does not control how a
robot does its mission.
"""
