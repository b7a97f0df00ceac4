"""Accepted load steps, their slip, and their files."""
