"""The dual operator A, cheap approximations of it, and its first products."""
