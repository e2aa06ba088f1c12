"""Words, tokens and noun phrases of English: the part that missions and paths share."""
