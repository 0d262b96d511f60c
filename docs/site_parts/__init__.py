"""The parts of the site that are generated: commands, faults and codes, figures, the gallery."""
