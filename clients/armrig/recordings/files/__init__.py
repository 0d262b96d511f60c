"""Files of recordings: reading, verification, search and export."""
