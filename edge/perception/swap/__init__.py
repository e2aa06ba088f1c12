"""Swap of a model in the running service: load, try, switch, watch, then keep or roll back.

This package needs only the worker that runs the model; it does not know how requests arrive.
"""
