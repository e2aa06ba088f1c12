"""Perception: detectors, scorers, the runtime of their models, and objects fused over time.

Nothing here updates the occupancy map or selects a goal.
"""
