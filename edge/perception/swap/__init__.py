"""Another model in the running service: loaded beside, tried, switched to, watched, kept or not."""
