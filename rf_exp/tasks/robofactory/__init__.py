"""What is of the authors' release: how it calls its cameras."""
