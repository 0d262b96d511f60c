"""Commands to the daemon, the codes of its answers, and the rehearsal of a run."""
