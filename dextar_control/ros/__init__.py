"""The nodes, thin around the core."""
