"""Other solvers of contact problems for benchmarks/peers.py, with a file for each kind."""
