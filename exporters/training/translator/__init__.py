"""The small translator: its sentences, its network, its training, and the files it becomes."""
