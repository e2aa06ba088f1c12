"""Map of the robot's surroundings: occupancy, frontiers, driving distances, detector coverage.

Numba kernels over plain arrays. It knows no stages and no policies.
"""
