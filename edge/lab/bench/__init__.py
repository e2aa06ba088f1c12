"""`edge bench --models`: every variant of a family on the same frames (VL-Nav section V.D).

Each variant is timed in a process of its own; nothing here chooses a model.
"""
