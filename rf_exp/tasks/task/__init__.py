"""What every task has: its configuration, the starts of its episodes, and who judges them."""
