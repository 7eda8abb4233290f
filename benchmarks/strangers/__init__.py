"""Controllers on joints that the library does not model."""
