"""Unsuitable versions of Python; tools/venvs.py reads this file, too, where DOLFINx is missing."""

#: Versions whose `functools.singledispatchmethod`, used by UFL, keeps its arguments for ever, and so
#: every mesh.
LEAKING = ((3, 13, 0), (3, 13, 1))
