"""Linear algebra, polynomials and statistics on arrays; nothing here knows a Dataset."""
