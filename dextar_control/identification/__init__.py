"""A robot's own numbers from what it recorded of itself."""
