"""Scores of candidates by vision-language models and by the prior."""
