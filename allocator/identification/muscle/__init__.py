"""Identification of a muscle from measured forces."""
