"""Meshes that are refined where the error is, until the answer is as accurate as was asked for."""
