"""The paper's equations for any mechanism, on symbols and as fast functions."""
