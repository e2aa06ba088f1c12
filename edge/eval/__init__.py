"""Measures the whole: episodes in houses, task planners, translations, recorded runs."""
