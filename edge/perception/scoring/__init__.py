"""Scorers: models that judge a direction, a frontier or a whole image."""
