"""What one would take instead of dolfinx_tresca, for benchmarks/peers.py: a file for each kind."""
