"""The environments for others: their own checkers, what they promise, what they refuse."""
