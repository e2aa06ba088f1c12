"""Training of our own small networks and of the prior, from code and a seed only.

There is one command each: `python -m exporters.training.mini`, `.choice`, `.translator` and
`.prior`. It makes the training data, trains, evaluates on held-out data, and writes the file and
its card. A stopped run continues from its checkpoint. `learning`, `checkpoint` and `results` are
shared.
"""
