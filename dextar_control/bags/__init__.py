"""Files of recorded bags: their records, past damage, and which files are one recording."""
