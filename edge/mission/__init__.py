"""Missions: from words to a formula, from a formula to an automaton, from there to the next target.

It knows no sensor, no goal and no bus.
"""
