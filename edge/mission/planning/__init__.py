"""From an automaton and what is known of its targets to the next one (ViTL IV-A).

Letters, sets and distances: no words, no sensor, no goal.
"""
