"""A guaranteed bound of the error of the displacement (docs/theory/guaranteed.md)."""
