"""The dual operator A, its near field, and A as a matrix."""
