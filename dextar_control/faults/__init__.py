"""Faults put on purpose between the nodes, to count what becomes of them."""
