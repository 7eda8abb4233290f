"""A muscle is found from measured forces here."""
