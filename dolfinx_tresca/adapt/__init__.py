"""Adaptive refinement until the requested accuracy is reached."""
