"""Tests of a device against PROTOCOL.md: the suite tests a list of rules over a line."""
