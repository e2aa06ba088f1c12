"""Drawings of automata as shapes: what is shown, where it stands, how it looks, SVG and PNG."""
