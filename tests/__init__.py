"""Tests and their helpers: `from tests.integration.processes import Bench`."""
