"""Symbols and fast functions of them, whatever they stand for: no mechanism and no
paper here.
"""
