"""Where things stand by what stands around: learned counts and weights, as arrays.

`table` is what was learned (`python -m exporters.training.prior`), `cooccurrence` judges a place by
what is near it, `rooms` by the kind of room it is in. Neither knows the map, the loop, or a policy.
"""
