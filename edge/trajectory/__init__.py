"""From a map and a goal to a smooth path: cost maps, A*, splines, pure pursuit.

Pure functions of arrays: no publishing, and no state between calls.
"""
