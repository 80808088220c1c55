"""Symbols, and fast functions of them; nothing here knows a mechanism."""
