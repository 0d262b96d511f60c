"""Data of one's own, from a file: text, MATLAB's or numpy's, to a `Dataset`."""
