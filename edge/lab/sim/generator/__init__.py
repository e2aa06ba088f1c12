"""Houses by seed: floor plans, what rooms of a kind hold, and where it stands.

Nothing here reads a house of somebody else's, and nothing here knows the service.
"""
