"""Reading of CSV tables and bags, and writing of files that appear whole or not at all."""
