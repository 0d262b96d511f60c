"""Loading of a `Dataset` from text files, MAT-files and .npz files."""
