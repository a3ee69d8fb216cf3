"""What every artifact has, whatever is in it: who made it."""
