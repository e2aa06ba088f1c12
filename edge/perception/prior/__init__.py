"""Prior on where objects are, given the objects around: learned counts and weights, as arrays.

`table` holds the learned data (`python -m exporters.training.prior`). `cooccurrence` rates a place
by the objects near it, `rooms` by the kind of its room. These modules know neither the map nor the
loop nor a policy.
"""
