"""The nodes are thin around the mathematics."""
