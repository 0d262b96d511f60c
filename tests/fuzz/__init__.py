"""Fuzzing of what reads bytes that others wrote: frames, commands, recordings."""
