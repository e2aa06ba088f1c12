"""Sentences about paths: read by rules, written as steps."""
