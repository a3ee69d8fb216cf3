"""What an asset is: its parts and annotated points, and how it comes of a mesh and its annotation."""
