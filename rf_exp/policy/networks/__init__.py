"""Networks: encoders of pictures, heads that give actions, and what they are put together from."""
