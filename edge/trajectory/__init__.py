"""From a map and a goal to a smooth path: cost maps, A*, splines."""
