"""Linear algebra, polynomials and statistics on arrays; no function needs a Dataset."""
