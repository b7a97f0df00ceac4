"""Known products with A, and models of A that are built from them."""
