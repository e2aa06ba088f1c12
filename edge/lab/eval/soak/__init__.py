"""Endurance test: the service with a simulated robot in real time, for hours, under faults.

`faults` is the table of faults, `rules` the table of requirements. The service and the robot are
processes, as on a robot.
"""
