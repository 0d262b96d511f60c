"""Firmware upload to a board: choice of the board, avrdude, and the board's answer after it."""
