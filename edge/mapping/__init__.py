"""The map: occupancy, frontiers, driving distances and what the detector has looked at.

Numba kernels over plain arrays; no stage and no policy.
"""
