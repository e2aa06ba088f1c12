"""Training of the prior (`edge.perception.prior`): simulated searches of furnished houses.

`house` reads a house as a floor plan, `explorer` is a robot that searches on it, `samples` are the
decisions of such searches. `counts` counts objects by room, `learn` fits the prior's weights.
"""
