"""Metrics and health of the running service."""
