"""Generated bugs: each is planted in a module of the core or the device, and a test must see it."""
