"""From formulas to automata, and what is wrong with a formula.

Bounded in states and steps, never in time; no robot in it, and no English.
"""
