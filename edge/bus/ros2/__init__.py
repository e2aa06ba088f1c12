"""A node of a ROS 2 graph that speaks rmw_zenoh, without ROS: its names, tokens and endpoints.

What its messages hold is in `edge.bus.wire`. Whoever speaks so must be a client of the graph's
router (`zenoh.mode: client`), since that passes nothing on between peers.
"""
