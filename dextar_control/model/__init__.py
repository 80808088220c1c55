"""The paper's equations for any mechanism: on symbols (``equations``), and as fast
functions (``functions``).
"""
