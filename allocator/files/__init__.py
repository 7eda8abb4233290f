"""Reading of CSV tables and bags, and atomic writing of files."""
