"""From formulas to automata, and what is wrong with a formula. No robot in it."""
