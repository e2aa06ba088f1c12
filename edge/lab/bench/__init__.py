"""`edge bench --models`: measure every variant of a family on the same frames (VL-Nav section V.D).

Each variant is timed in its own process. The benchmark only reports; it does not choose a model.
"""
