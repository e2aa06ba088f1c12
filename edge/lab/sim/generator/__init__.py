"""Generated houses: floor plans, and furniture by the kind of room, from a seed.

No other house data set is read, and the service is not used.
"""
