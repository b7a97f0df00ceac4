"""Scenes at extremes, and the laws that their solutions must satisfy."""
