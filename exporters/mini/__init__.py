"""The small detector of our own: houses made by code, pictures of them, network, training."""
