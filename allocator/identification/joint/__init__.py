"""Identification of a joint from measured angles at rest."""
