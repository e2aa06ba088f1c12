"""Scorers: models that rate a direction, a frontier or an entire image."""
