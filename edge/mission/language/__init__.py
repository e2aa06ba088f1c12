"""From words to formulas of linear temporal logic: a grammar of English, or a language model."""
