"""The nodes, thin around the mathematics."""
