"""Answers to requests: about the mission, the memory, the site and the models."""
