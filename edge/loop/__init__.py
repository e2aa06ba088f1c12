"""Loop: the tick over all stages, goal tracking, and status reports.

The caller passes the source, the sinks and the request servers; this package does not import Zenoh.
It writes only checkpoints: of the mission, the map and the pictures of objects (`checkpoints`).
"""
