"""Unsuitable versions of Python; tools/venvs.py reads this file, too, where DOLFINx is missing."""

#: Versions whose `functools.singledispatchmethod`, used by UFL, never frees its arguments, so that
#: every mesh stays in memory.
LEAKING = ((3, 13, 0), (3, 13, 1))
