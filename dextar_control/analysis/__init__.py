"""A recorded run: load it, compute its metrics, draw it."""
