"""Tests for feedback and for a pure delay (handout 3.7 and 3.8)."""
