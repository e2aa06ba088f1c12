"""Recordings of a run as MCAP: how they are written and read, replayed and traced.

What is written is for Foxglove and the ROS 2 tools to show; the journal beside it holds what a
service must be given to do the same again. What takes a recording from where is in `edge.sinks` and
`edge.sources`.
"""
