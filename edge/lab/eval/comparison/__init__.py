"""Comparison of experiment arms: figures with intervals, tables, and a page.

It reads outcomes and loads their worlds. It runs no episode.
"""
