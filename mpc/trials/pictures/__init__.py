"""Pictures of a run: figures, films, and the report of the command line."""
