"""A governor is written as C here, its kernel printed from the text that Python runs."""
