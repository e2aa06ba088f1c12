"""Planning: from an automaton and the knowledge about its targets to the next target (ViTL IV-A).

This package works with propositions, sets and distances, without language, sensors or goals.
"""
