"""A node of a ROS 2 graph over rmw_zenoh, without ROS: its names, tokens and endpoints.

The message formats are in `edge.bus.wire`. The node must be a client of the graph's router
(`zenoh.mode: client`), because the router forwards nothing between peers.
"""
