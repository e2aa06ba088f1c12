"""What episodes tell of the columns that ran them: figures with intervals, tables, plots, a page.

It reads records of outcomes, and the worlds that they name; it runs no episode itself.
"""
