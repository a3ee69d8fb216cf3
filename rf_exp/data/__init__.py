"""Data sets for others: what is in a store, whether it is whole, merging, and formats that others read."""
