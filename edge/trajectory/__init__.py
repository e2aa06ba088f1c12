"""From a map and a goal to a smooth path: cost maps, A*, splines.

Arrays and kernels: nothing here drives, subscribes or knows a mission.
"""
