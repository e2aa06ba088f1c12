"""Another model in the running service: loaded beside, tried, switched to, watched, kept or not.

The loop asks for nothing but the detector's worker; how requests come in is not known here.
"""
