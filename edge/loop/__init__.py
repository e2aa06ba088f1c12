"""The loop: one tick over all stages, the present goal from choice to answer, what both report.

It takes a source and sinks as it is given them, and knows neither Zenoh nor files.
"""
