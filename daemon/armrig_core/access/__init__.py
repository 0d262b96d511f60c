"""The way to a daemon: endpoints, identities, permissions and locks."""
