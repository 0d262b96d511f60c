"""Firmware upload: choice of the board, calls of avrdude, and the board's answer afterwards."""
