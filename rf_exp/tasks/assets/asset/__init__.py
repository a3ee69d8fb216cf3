"""The asset class: parts and annotated points; assets from annotated meshes."""
