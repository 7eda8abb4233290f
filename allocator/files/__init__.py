"""CSV tables are read here, and files written that appear whole or not at all."""
