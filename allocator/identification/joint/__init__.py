"""A joint is found from measured angles at rest here."""
