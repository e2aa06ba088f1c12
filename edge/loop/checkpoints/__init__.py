"""Checkpoints: mission and map on disk, and back after a restart."""
