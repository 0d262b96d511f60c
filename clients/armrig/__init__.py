"""Record, identify and validate models of a control laboratory's rig."""
