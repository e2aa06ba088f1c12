"""Tracking: from boxes in an image to objects in the map, fused over time."""
