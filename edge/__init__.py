"""Edge inference service for vision-language navigation."""

__version__ = "0.1.0"
