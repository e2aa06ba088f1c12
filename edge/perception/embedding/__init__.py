"""Embeddings of texts and images, by vocabularies and encoders."""
