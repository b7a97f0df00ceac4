"""The dual problem: minimise q over Lambda."""
