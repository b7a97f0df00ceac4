"""The set Lambda, its projection, and equality constraints besides it."""
