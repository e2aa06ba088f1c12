"""Errands: rewrite everyday requests (bring, check, tour, look for) into plain instructions."""
