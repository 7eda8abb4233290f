"""Learning of one motion by repeating it: iterative corrections of the reference that a controller is given."""
