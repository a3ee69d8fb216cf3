"""How pictures are drawn: shaders of our own, and textures that are computed."""
