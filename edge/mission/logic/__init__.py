"""Linear temporal logic over finite traces: formulas, normal forms, automata. No robot in it."""
