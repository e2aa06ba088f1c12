"""`edge eval trajectories`: what instructions mean as trajectories, and how near methods come.

Places and tasks with their references (`meaning`, `episodes`), methods and their baselines
(`methods`), outcomes and what they say (`outcomes`, `tables`, `plots`), the command (`run`).
"""
