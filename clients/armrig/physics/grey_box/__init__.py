"""Physical parameters from data (handout 3.5 and 3.6): estimate, second opinion, split study."""
