"""Networks that translate what the grammar refuses: the built-in one, and language models."""
