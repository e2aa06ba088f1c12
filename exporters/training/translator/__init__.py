"""Training of the small translator: sentences, network, training loop, and export."""
