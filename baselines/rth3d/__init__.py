"""RTH3D."""
