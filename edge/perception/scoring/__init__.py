"""Scorers: models that rate a direction, a frontier or a whole image."""
