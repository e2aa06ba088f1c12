"""Generated houses: floor plans, and furniture by the kind of room, from a seed.

`house.generated_house` makes one. `layout` draws the rooms and doors, `contents` has the tables of
furniture, `furnish` places it. No data set of houses is read, and the service is not used.
"""
