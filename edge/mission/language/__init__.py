"""From words to formulas of linear temporal logic: a grammar of English, a small
network of our own (`model`), or a language model on a server (`llm`).

What is not understood is refused or asked about; what is compiled is only compared.
"""
