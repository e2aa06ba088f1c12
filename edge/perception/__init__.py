"""What the camera shows: detectors, scorers, their models, and instances in the map.

No map is updated and no goal chosen here.
"""
