"""What every artifact has, whatever is in it: who made it and of what, and that it is whole."""
