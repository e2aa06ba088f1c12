"""Behaviours that carry out a mission. Each gathers candidates, plans, and selects a goal."""
