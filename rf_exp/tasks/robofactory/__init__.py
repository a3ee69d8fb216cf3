"""What is of the authors' release: its cameras and what they are called, assets in the place of ours."""
