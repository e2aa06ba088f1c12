"""Grammar: reads an instruction and builds its formula, and describes formulas in English."""
