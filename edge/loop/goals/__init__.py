"""Current goal: candidates, choice, tracking until the controller answers."""
