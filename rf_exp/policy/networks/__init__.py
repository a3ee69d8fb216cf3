"""Networks: encoders of pictures, heads that predict actions, and the policy composed of them."""
