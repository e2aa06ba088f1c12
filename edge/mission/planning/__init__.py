"""From an automaton and what is known of its targets to the next one (ViTL IV-A)."""
