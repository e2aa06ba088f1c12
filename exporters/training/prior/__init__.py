"""Training of the prior (`edge.perception.prior`) from searches of furnished houses on a plan."""
