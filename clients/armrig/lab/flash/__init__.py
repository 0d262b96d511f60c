"""The firmware goes to a board: which board, avrdude that writes, what the board says then."""
