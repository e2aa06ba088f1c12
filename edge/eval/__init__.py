"""Measures the whole: episodes in houses, task planners, translations, recorded runs.

Whatever it measures runs as it does on a robot; nothing on a robot imports it.
"""
