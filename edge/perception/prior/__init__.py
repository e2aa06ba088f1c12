"""Prior on where objects are, given the objects around: learned counts and weights, as arrays.

`table` holds the learned data (`python -m exporters.training.prior`). `cooccurrence` rates a place
by the objects near it, `rooms` by the kind of room it is in. None of them knows the map, the loop
or a policy.
"""
