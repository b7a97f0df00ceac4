"""Scenes at extremes, and what their solutions must fulfil."""
