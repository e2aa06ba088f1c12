"""Translation of instructions to formulas by grammar, network or language model, and back."""
