"""Detectors: find what the prompts name in an image."""
