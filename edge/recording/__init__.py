"""Recordings of a run as MCAP: writing, reading, replay and traces.

Most channels are for Foxglove and the ROS 2 tools. The journal channel holds the inputs that a
service needs to repeat the run. The sinks and sources that use recordings are in `edge.sinks` and
`edge.sources`.
"""
