"""Who may command: access rules for DDS security, made from the contract."""
