"""Access rules for DDS security, made from the contract, say who may command."""
