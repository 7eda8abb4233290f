"""Iterative learning of one motion: corrections of a controller's reference from repetition to repetition."""
