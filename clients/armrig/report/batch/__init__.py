"""One task for many recordings, on one or more machines; a stopped batch can continue."""
