"""Endurance: the service with a simulated robot in real time, through faults, for hours.

`faults` is the table of what is done to it, `rules` of what must hold. The service and the robot
are processes as on a robot; nothing in here runs in the service but the sink of `beat`.
"""
