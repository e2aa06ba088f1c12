"""Detectors: find the objects that the prompts name in an image."""
