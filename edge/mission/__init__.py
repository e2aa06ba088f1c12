"""Missions: instruction to formula, formula to automaton, automaton to the next target.

This package knows no sensors, no goals and no bus.
"""
