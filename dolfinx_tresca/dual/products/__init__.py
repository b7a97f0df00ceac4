"""Products with A = B K^-1 B', and what is known of A without them.

- `DualOperator`: a product is one solve with K; every one is counted.
- `NearField`: a cheap approximation of A, with the bodies clamped some cells from the contact.
- `sparse_model`, `dense_model`: A as a matrix, for many small bodies or for few multipliers.
- `ContactCompliance`: all of them for one B and one K, computed when first needed.

Read first: `operator.DualOperator.apply`, `compliance.ContactCompliance.known_products`.
"""
