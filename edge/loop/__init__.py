"""The loop: one tick over all stages, the present goal from choice to answer, what both report.

It takes a source, sinks and requests as it is given them, and does not load Zenoh. All
that it writes is the checkpoint, of the mission and of the map (`checkpoint`).
"""
