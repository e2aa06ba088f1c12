"""Segmenters: masks of the objects in a detector's boxes."""
