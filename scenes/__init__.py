"""Scenes that tests and benchmarks share: each is defined once, in the file of its name.

A scene is a function of a communicator and of sizes that returns a `Scene`: forms, conditions,
pairs, and what one may change or compare with. It knows the package, and nothing of who uses it.
"""
