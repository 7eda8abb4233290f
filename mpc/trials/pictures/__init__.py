"""Pictures of a run: figures, films, and the report that the command line writes."""
