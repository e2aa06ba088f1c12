"""From a map and a goal to a smooth path: cost maps, A*, splines.

Arrays in, paths out: nothing here drives, publishes or remembers a goal.
"""
