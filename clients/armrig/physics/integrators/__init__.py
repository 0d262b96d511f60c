"""Numerical integration of x' = A x + B u (handout, chapter 4)."""
