"""Scene of a task: objects, ground and outlines from images and clouds, as maps and pictures."""
