"""CasADi's expression graphs are written as text for compilers here: by one walk, and a table for each language."""
