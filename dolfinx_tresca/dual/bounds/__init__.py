"""Bounds and estimates of errors of the displacement."""
