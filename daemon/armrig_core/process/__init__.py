"""The running program: files and texts from outside, calls, signals, sockets and waits."""
