"""Temporal logic: formulas, their automata, and diagnosis of useless formulas.

Compilation is limited in states and steps, not in time. This package has no robots and no English.
"""
