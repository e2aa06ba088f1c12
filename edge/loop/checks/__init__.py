"""Checks of the sensors' data: poses, depth against motion, frames."""
