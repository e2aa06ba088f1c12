"""Trains the small networks of our own, from nothing but code and a seed, and learns the prior.

One command each, `python -m exporters.training.mini`, `.choice`, `.translator` and `.prior`, makes
what it learns from, trains, measures on what training never saw, and writes the file and its card.
A run that was stopped goes on where it was. `learning` and `checkpoint` are what they share.
"""
