"""From words to formulas of linear temporal logic: a grammar of English, or a language model.

What is not understood is refused or asked about; nothing is compiled or planned here.
"""
