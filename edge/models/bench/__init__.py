"""`edge models bench`: every variant of a family on the same frames (VL-Nav section V.D)."""
