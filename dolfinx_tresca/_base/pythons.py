"""Versions of Python that do not suit; read by tools/venvs.py too, where there is no DOLFINx."""

#: Their `functools.singledispatchmethod`, used by UFL, keeps its arguments, and so every mesh.
LEAKING = ((3, 13, 0), (3, 13, 1))
