"""The timing of one host against the limit: what runs in turn, what is compared, the targets.

Each of the contestants is a program of its own; `rounds` lets them take turns, `targets` compares
what they measured. Nothing here imports the daemon: it is started as its users start it.
"""
